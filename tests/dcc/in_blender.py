"""Runs inside Blender: python in_blender.py STEP FOLDER with bpy, or blender -b --python in_blender.py -- STEP FOLDER.

STEP is import, or reopen in a process of its own after that. FOLDER has sample.h5 (200 strands, frames 3 to 8),
other.h5 (fewer strands), many.h5 (20,000 strands), strandcache.zip, and for reopen sample.abc where there is Alembic.
"""

import contextlib
import io
import pathlib
import sys
import time

import bpy
import h5py
import numpy as np

step, folder = sys.argv[-2], pathlib.Path(sys.argv[-1])
sample = str(folder / "sample.h5")


with h5py.File(sample, "r", locking=False) as cache:
    positions, offset = cache["frames/position"][:], cache["strands/offset"][:]
    region, root_uv = cache["strands/region"][:], cache["strands/root_uv"][:]


def in_blender(points, scale=1):
    """Metres with y up as Blender has them."""
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1) * np.float32(scale)


def shown(thing):
    """Positions as Blender evaluates them for a picture."""
    data = thing.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    points = np.empty(3 * len(data.points), np.float32)
    data.attributes["position"].data.foreach_get("vector", points)
    return points.reshape(-1, 3)


def attribute(curves, name, field, columns, kind):
    found = curves.attributes[name]
    values = np.empty(len(found.data) * columns, kind)
    found.data.foreach_get(field, values)
    return found.domain, values.reshape(-1, columns).squeeze()


def install():
    archive = str(folder / "strandcache.zip")
    if bpy.app.version >= (4, 2, 0):
        bpy.ops.extensions.package_install_files(filepath=archive, repo="user_default", enable_on_install=True)
    else:
        bpy.ops.preferences.addon_install(filepath=archive)
        bpy.ops.preferences.addon_enable(module="strandcache")


def enable():
    import addon_utils

    addon_utils.enable("bl_ext.user_default.strandcache" if bpy.app.version >= (4, 2, 0) else "strandcache")


def import_file(path, **options):
    before = set(bpy.data.objects)
    assert bpy.ops.import_scene.strandcache(filepath=str(path), **options) == {"FINISHED"}
    (thing,) = set(bpy.data.objects) - before
    return thing


def check_import():
    install()
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    thing = import_file(sample, radius=1e-3)
    curves = thing.data
    assert thing.type == "CURVES" and bpy.data.meshes[:] == [] and bpy.data.node_groups[:] == []
    assert (scene.render.fps / scene.render.fps_base, scene.frame_start, scene.frame_end) == (24, 3, 8)
    first = [curve.first_point_index for curve in curves.curves]
    assert first == offset[:-1].tolist() and len(curves.points) == offset[-1]
    for name, field, columns, kind, expected, domain in (
        ("strand_id", "value", 1, np.int32, np.arange(200), "CURVE"),
        ("region", "value", 1, np.int32, region, "CURVE"),
        ("surface_uv_coordinate", "vector", 2, np.float32, root_uv, "CURVE"),
        ("radius", "value", 1, np.float32, np.full(offset[-1], 1e-3, np.float32), "POINT"),
        ("curve_type", "value", 1, np.int32, np.ones(200), "CURVE"),
    ):  # polylines
        found, values = attribute(curves, name, field, columns, kind)
        assert found == domain, name
        np.testing.assert_array_equal(values, expected, name)
    assert curves["regions"] == "top\ntail\nStirnzöpfchen"
    for frame in (3, 5, 8, 4):
        scene.frame_set(frame)
        np.testing.assert_array_equal(shown(thing), in_blender(positions[frame - 3]))
    for frame, index in ((1, 0), (20, 5)):  # before and behind the shot
        scene.frame_set(frame)
        np.testing.assert_array_equal(shown(thing), in_blender(positions[index]))
    check_time(scene, thing)
    check_units(scene)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "shot.blend"))


def check_time(scene, thing):
    settings = thing.data.strandcache
    scene.frame_set(5)
    settings.frame_offset = 100
    scene.frame_set(106)
    np.testing.assert_array_equal(shown(thing), in_blender(positions[3]))
    settings.frame_offset, settings.speed = 0, 0.5
    scene.frame_set(10)
    np.testing.assert_array_equal(shown(thing), in_blender(positions[2]))
    scene.frame_set(9)  # between frames 4 and 5
    np.testing.assert_allclose(shown(thing), in_blender((positions[1] + positions[2]) / 2), atol=1e-6)
    settings.speed = 1
    scene.frame_set(5, subframe=0.25)
    np.testing.assert_allclose(shown(thing), in_blender(0.75 * positions[2] + 0.25 * positions[3]), atol=1e-6)
    settings.override_frame = True  # its keys run from 3 to 8; now backwards
    for frame, number in ((3, 8), (8, 3)):
        settings.frame = number
        settings.keyframe_insert("frame", frame=frame)
    for frame in (3, 6, 8):
        scene.frame_set(frame)
        np.testing.assert_allclose(shown(thing), in_blender(positions[8 - frame]), atol=2e-6)
    settings.override_frame = False
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(shown(thing), in_blender(positions[5]))  # at once, without a change of frame


def check_units(scene):
    scene.unit_settings.scale_length = 0.01  # the scene is in centimetres
    scene.render.fps = 48
    thing = import_file(sample, radius=1e-3, set_scene=False)
    assert thing.data.strandcache.speed == 0.5 and scene.render.fps == 48
    scene.frame_set(10)
    np.testing.assert_allclose(shown(thing), in_blender(positions[2], 100), rtol=1e-6)
    np.testing.assert_allclose(attribute(thing.data, "radius", "value", 1, np.float32)[1], 0.1, rtol=1e-6)
    bpy.data.objects.remove(thing)
    scene.unit_settings.scale_length, scene.render.fps = 1, 24


def check_reopened():
    """In a new process: the saved file plays."""
    enable()
    bpy.ops.wm.open_mainfile(filepath=str(folder / "shot.blend"))
    scene, thing = bpy.context.scene, bpy.data.objects["sample"]
    for frame in (4, 7):
        scene.frame_set(frame)
        np.testing.assert_array_equal(shown(thing), in_blender(positions[frame - 3]))
    check_faults(scene, thing)
    bpy.ops.wm.open_mainfile(filepath=str(folder / "shot.blend"))
    render(bpy.context.scene, bpy.data.objects["sample"])


def check_faults(scene, thing):
    (folder / "cut.h5").write_bytes(pathlib.Path(sample).read_bytes()[:5000])
    for path, words in (
        (folder / "cut.h5", "is a damaged or truncated HDF5 file"),
        (folder / "none.h5", "there is no such file"),
        (folder / "in_blender.py", "is not an HDF5 file"),
    ):
        before = len(bpy.data.objects)
        try:
            bpy.ops.import_scene.strandcache(filepath=str(path))
            raise AssertionError(f"{path} was imported")
        except RuntimeError as error:
            assert words in str(error), error
        assert len(bpy.data.objects) == before
    scene.frame_set(4)
    for path, words in ((folder / "none.h5", "there is no such file"), (folder / "other.h5", "import it anew")):
        told = io.StringIO()
        with contextlib.redirect_stderr(told):
            thing.data.strandcache.filepath = str(path)
            for frame in (5, 6, 7):
                scene.frame_set(frame)
        assert words in told.getvalue() and told.getvalue().count("\n") == 1, told.getvalue()
        np.testing.assert_array_equal(shown(thing), in_blender(positions[1]))  # the last good hair stays
    thing.data.strandcache.filepath = sample
    scene.frame_set(8)
    np.testing.assert_array_equal(shown(thing), in_blender(positions[5]))


def render(scene, thing):
    """A small still: hair that is white on black, upright, where the camera looks."""
    scene.frame_set(5)
    points = in_blender(positions[2])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 2
    camera.location, camera.rotation_euler = (middle[0], middle[1] - 5, middle[2]), (np.pi / 2, 0, 0)
    material = bpy.data.materials.new("white")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    links.new(nodes.new("ShaderNodeEmission").outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs[0])
    thing.data.materials.append(material)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 4, False
    scene.render.resolution_x = scene.render.resolution_y = 160
    scene.view_settings.view_transform = "Standard"
    scene.render.filepath = str(folder / "still.png")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    pixels = np.array(image.pixels[:]).reshape(160, 160, 4)[..., 0] > 0.3  # from below
    rows, columns = np.nonzero(pixels)
    # Where the vertices are, in pixels: 80 a metre about the middle.
    expected = (points[:, [0, 2]] - middle[[0, 2]]) * 80 + 80
    # Older ones draw smooth curves through the vertices of the sample's wild strands.
    slack = 3 if bpy.app.version >= (5, 0, 0) else 12
    for found, wanted in ((columns, expected[:, 0]), (rows, expected[:, 1])):
        assert abs(found.min() - wanted.min()) < slack, (found.min(), wanted.min())
        assert abs(found.max() + 1 - wanted.max()) < slack, (found.max(), wanted.max())
    print(f"still: {pixels.mean():.0%} of the pixels show hair")


def measure():
    bpy.ops.wm.read_homefile(use_empty=True)
    many, scene = str(folder / "many.h5"), bpy.context.scene
    start = time.perf_counter()
    thing = import_file(many)
    built = time.perf_counter() - start
    times = []
    for frame in range(1, 11):
        start = time.perf_counter()
        scene.frame_set(frame)
        times.append(time.perf_counter() - start)
    with h5py.File(many, "r", locking=False) as file:
        np.testing.assert_array_equal(shown(thing), in_blender(file["frames/position"][-1]))
    print(
        f"Blender {bpy.app.version_string}: 20,000 strands of 11 vertices were there after {built:.3f} s, "
        f"a frame took {1e3 * sorted(times)[5]:.1f} ms"
    )


def check_alembic():
    """What strandcache to-abc has written, as Blender's own importer reads it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.alembic_import(filepath=str(folder / "sample.abc"))
    scene = bpy.context.scene
    (thing,) = [thing for thing in bpy.data.objects if thing.type == "CURVES"]
    for frame in range(3, 9):
        scene.frame_set(frame)
        np.testing.assert_array_equal(shown(thing), in_blender(positions[frame - 3]))
    assert [curve.points_length for curve in thing.data.curves] == np.diff(offset).tolist()
    widths = attribute(
        thing.evaluated_get(bpy.context.evaluated_depsgraph_get()).data, "radius", "value", 1, np.float32
    )[1]
    np.testing.assert_allclose(widths, 2e-4, rtol=1e-5)


if step == "import":
    check_import()
else:
    check_reopened()
    measure()
    if (folder / "sample.abc").exists():
        check_alembic()
print("done", step)
