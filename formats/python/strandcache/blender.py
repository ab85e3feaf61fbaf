"""Caches in Blender, from 3.4 on: hair curves that play a cache back, an add-on for that, and Alembic through Blender.

A curves data block knows its cache (`curves.strandcache`); handlers give it the positions of each frame. Both are there
as long as the add-on is enabled, so a saved file plays when it is opened again.
"""

import os
import sys
from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent
from numpy.typing import NDArray

from .cache import Cache, CacheError, Floats

# What was read last of each cache, and what the file was then.
_open_caches: dict[str, tuple[tuple[int, int, int], "_Playback"]] = {}
# Curves whose cache cannot be played: why.
_faults: dict[str, str] = {}


class _Playback:
    """A cache with the frames that were read last, as neighbours on the time line want the same ones."""

    def __init__(self, path: str) -> None:
        self.cache = Cache(path)
        if len(self.cache) == 0:
            raise CacheError(f"{path}: has no frame yet")
        self._kept: dict[int, Floats] = {}

    def positions(self, number: float) -> Floats:
        """Between two frames in a straight line; before the first and behind the last frame these stand."""
        numbers = self.cache.numbers
        after = int(np.searchsorted(numbers, number, side="left"))
        if after == len(numbers):
            return self._frame(after - 1)
        if after == 0 or numbers[after] == number:
            return self._frame(after)
        share = np.float32((number - numbers[after - 1]) / (numbers[after] - numbers[after - 1]))
        before = self._frame(after - 1)
        return before + share * (self._frame(after) - before)

    def _frame(self, index: int) -> Floats:
        if index not in self._kept:
            while len(self._kept) > 1:
                del self._kept[next(iter(self._kept))]
            self._kept[index] = self.cache.positions(index)
        return self._kept[index]


def _playback(path: str) -> _Playback:
    """Opens a cache again when it was baked again."""
    try:
        status = os.stat(path)
    except OSError as error:
        raise CacheError(f"{path}: there is no such file") from error
    stamp = (status.st_ino, status.st_size, status.st_mtime_ns)
    if path not in _open_caches or _open_caches[path][0] != stamp:
        _forget(path)
        _open_caches[path] = (stamp, _Playback(path))
    return _open_caches[path][1]


def _forget(path: str) -> None:
    if path in _open_caches:
        _open_caches.pop(path)[1].cache.close()


def _to_blender(positions: Floats, scene: bpy.types.Scene) -> Floats:
    """Metres with y up to the scene's units with z up, flat as foreach_set takes them."""
    units = scene.unit_settings
    scale = np.float32(1 / units.scale_length if units.system != "NONE" else 1)
    out = np.empty_like(positions)
    np.multiply(positions[:, 0], scale, out=out[:, 0])
    np.multiply(positions[:, 2], -scale, out=out[:, 1])
    np.multiply(positions[:, 1], scale, out=out[:, 2])
    return out.reshape(-1)


def _put_positions(curves: Any, scene: bpy.types.Scene, settings: Any) -> None:
    playback = _playback(bpy.path.abspath(settings.filepath, library=curves.library))
    if playback.cache.vertex_count != len(curves.points):
        raise CacheError(
            f"{settings.filepath}: has {playback.cache.vertex_count} vertices, but these curves have "
            f"{len(curves.points)}; import it anew"
        )
    number = settings.frame
    if not settings.override_frame:
        number = (scene.frame_current + scene.frame_subframe - settings.frame_offset) * settings.speed
    curves.attributes["position"].data.foreach_set("vector", _to_blender(playback.positions(number), scene))
    curves.update_tag()


def _show(curves: Any, scene: bpy.types.Scene, settings: Any) -> None:
    """What is wrong is told once, not in each frame, and the last good hair stays."""
    try:
        _put_positions(curves, scene, settings)
        _faults.pop(curves.name_full, None)
    except CacheError as error:
        if _faults.get(curves.name_full) != str(error):
            print(f"strandcache: {error}", file=sys.stderr)
        _faults[curves.name_full] = str(error)


@persistent
def _before_frame(scene: bpy.types.Scene, _depsgraph: Any = None) -> None:
    for curves in bpy.data.hair_curves:
        if curves.strandcache.filepath and not curves.strandcache.override_frame:
            _show(curves, scene, curves.strandcache)


@persistent
def _after_frame(scene: bpy.types.Scene, depsgraph: Any = None) -> None:
    """What is keyed has its value of this frame only now, in the evaluated copy. Blender evaluates the hair once more."""
    for curves in bpy.data.hair_curves:
        if curves.strandcache.filepath and curves.strandcache.override_frame:
            _show(curves, scene, (curves.evaluated_get(depsgraph) if depsgraph else curves).strandcache)


def _on_change(settings: Any, context: Any) -> None:
    if settings.filepath:
        _show(settings.id_data, context.scene, settings)


def import_cache(path: str | os.PathLike[str], *, radius: float = 5e-5, set_scene: bool = True) -> bpy.types.Object:
    """Adds hair curves to the current scene that play a cache, and returns their object.

    Each strand is a curve with the attributes strand_id, region (a number; the names are curves["regions"], one a line)
    and, where the cache has them, surface_uv_coordinate. `curves.strandcache` says how it is played.

    radius: of the strands, in metres.
    set_scene: gives the scene the cache's frame rate and frame range. Otherwise the cache is played at its own rate in
        the scene's.

    Raises CacheError.
    """
    register()
    path = os.path.abspath(path)
    scene = bpy.context.scene
    cache = _playback(path).cache
    name = os.path.splitext(os.path.basename(path))[0]
    rest = _to_blender(cache.positions(0), scene)
    curves = _make_curves(name, rest, cache.offset)
    types: list[tuple[str, str, str, NDArray[Any]]] = [
        ("strand_id", "INT", "value", np.arange(cache.strand_count, dtype=np.int32)),
        ("region", "INT", "value", cache.strand_region.astype(np.int32)),
    ]
    if cache.root_uv is not None:
        types.append(("surface_uv_coordinate", "FLOAT2", "vector", cache.root_uv))
    for label, kind, field, values in types:
        curves.attributes.new(label, kind, "CURVE").data.foreach_set(field, values.reshape(-1))
    in_units = radius * float(_to_blender(np.ones((1, 3), np.float32), scene)[0])
    widths = np.full(cache.vertex_count, in_units, np.float32)
    attribute = curves.attributes.get("radius") or curves.attributes.new("radius", "FLOAT", "POINT")
    attribute.data.foreach_set("value", widths)
    curves["regions"] = "\n".join(region.name for region in cache.regions)

    rate = scene.render.fps / scene.render.fps_base
    if set_scene:
        scene.render.fps = max(1, round(cache.fps))
        scene.render.fps_base = scene.render.fps / cache.fps
        scene.frame_start, scene.frame_end = int(cache.numbers[0]), int(cache.numbers[-1])
    curves.strandcache.speed = 1 if set_scene else cache.fps / rate
    curves.strandcache.filepath = path
    _key_frames(curves, int(cache.numbers[0]), int(cache.numbers[-1]))
    thing = bpy.data.objects.new(name, curves)
    scene.collection.objects.link(thing)
    return thing


def _key_frames(curves: Any, first: int, last: int) -> None:
    """Keys for `frame`, to begin a retiming with. Also, exporters take curves without keys for still."""
    for number in (first, last):
        curves.strandcache.frame = number
        curves.strandcache.keyframe_insert("frame", frame=number)
    action = curves.animation_data.action
    if hasattr(action, "fcurves"):
        channels = action.fcurves
    else:
        channels = action.layers[0].strips[0].channelbag(curves.animation_data.action_slot).fcurves
    for channel in channels:
        for key in channel.keyframe_points:
            key.interpolation = "LINEAR"


def _make_curves(name: str, positions: Floats, offset: NDArray[np.int64]) -> Any:
    if hasattr(bpy.types.Curves, "add_curves"):
        curves = bpy.data.hair_curves.new(name)
        curves.add_curves(np.diff(offset).tolist())
        curves.set_types(type="POLY")
        curves.attributes["position"].data.foreach_set("vector", positions)
        return curves
    return _convert_mesh(name, positions, offset)


def _convert_mesh(name: str, positions: Floats, offset: NDArray[np.int64]) -> Any:
    """In old Blenders, Python cannot add hair curves, but it can have a mesh of edges converted into them."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(positions) // 3)
    mesh.vertices.foreach_set("co", positions)
    ends = np.delete(np.arange(len(positions) // 3, dtype=np.int32), offset[:-1])  # an edge ends anywhere but at a root
    mesh.edges.add(len(ends))
    mesh.edges.foreach_set("vertices", np.stack([ends - 1, ends], axis=1).reshape(-1))
    group = bpy.data.node_groups.new("strandcache", "GeometryNodeTree")
    if hasattr(group, "interface"):
        group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
        group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    else:
        group.inputs.new("NodeSocketGeometry", "Geometry")
        group.outputs.new("NodeSocketGeometry", "Geometry")
    enter, leave = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    convert = group.nodes.new("GeometryNodeMeshToCurve")
    group.links.new(enter.outputs[0], convert.inputs[0])
    group.links.new(convert.outputs[0], leave.inputs[0])
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(thing)
    thing.modifiers.new("strandcache", "NODES").node_group = group
    layer = bpy.context.view_layer
    was_active, were_selected = layer.objects.active, list(bpy.context.selected_objects)
    for other in were_selected:
        other.select_set(False)
    thing.select_set(True)
    layer.objects.active = thing
    try:
        bpy.ops.object.convert(target="CURVES")
        converted = layer.objects.active
        curves = converted.data
    finally:
        layer.objects.active = was_active
        for other in were_selected:
            other.select_set(True)
    bpy.data.objects.remove(converted)
    mesh.user_clear()  # 3.4 forgets that the object does not use it any more
    bpy.data.meshes.remove(mesh)
    bpy.data.node_groups.remove(group)
    return curves


def to_alembic(path: str | os.PathLike[str], target: str | os.PathLike[str], **options: Any) -> None:
    """Writes a cache as Alembic curves, all frames. For a process of its own: what else Blender has open is dropped.

    options: of import_cache. Raises CacheError where the cache is damaged, OSError where the file cannot be written.
    """
    if not hasattr(bpy.ops.wm, "alembic_export") or not bpy.app.build_options.alembic:
        raise ImportError(f"this Blender ({bpy.app.version_string}) was built without Alembic; pip install bpy has it")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    import_cache(path, **options)
    scene = bpy.context.scene
    bpy.ops.wm.alembic_export(
        filepath=os.fspath(target),
        start=scene.frame_start,
        end=scene.frame_end,
        export_custom_properties=True,
        check_existing=False,
    )
    if _faults:
        raise CacheError(next(iter(_faults.values())))
    if not os.path.exists(target):
        raise OSError(f"{os.fspath(target)}: cannot be written")


class StrandcacheSettings(bpy.types.PropertyGroup):
    """How curves play their cache."""

    filepath: bpy.props.StringProperty(  # type: ignore[valid-type]
        name="File", description="The cache", subtype="FILE_PATH", options=set(), update=_on_change
    )
    frame_offset: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Offset", description="Frames by which the shot starts later", options=set(), update=_on_change
    )
    speed: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Speed",
        description="Frames of the cache in one frame of the scene",
        default=1,
        options=set(),
        update=_on_change,
    )
    override_frame: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Override Frame",
        description="Show the frame below, which may be keyed, in place of the scene's",
        options=set(),
        update=_on_change,
    )
    frame: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Frame", description="Frame of the cache", update=_on_change
    )


class STRANDCACHE_OT_import(bpy.types.Operator):
    """Import hair from a cache of Strandbake"""

    bl_idname = "import_scene.strandcache"
    bl_label = "Import Strand Cache"
    bl_options = {"REGISTER", "UNDO"}

    filepath: bpy.props.StringProperty(subtype="FILE_PATH")  # type: ignore[valid-type]
    filter_glob: bpy.props.StringProperty(default="*.h5;*.part", options={"HIDDEN"})  # type: ignore[valid-type]
    radius: bpy.props.FloatProperty(  # type: ignore[valid-type]
        name="Radius", description="Of the strands, in metres", default=5e-5, min=0, precision=6
    )
    set_scene: bpy.props.BoolProperty(  # type: ignore[valid-type]
        name="Set Scene", description="Give the scene the frame rate and the frame range of the cache", default=True
    )

    def invoke(self, context: Any, _event: Any) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: Any) -> set[str]:
        try:
            import_cache(self.filepath, radius=self.radius, set_scene=self.set_scene)
        except CacheError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class STRANDCACHE_PT_settings(bpy.types.Panel):
    bl_label = "Strand Cache"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "data"

    @classmethod
    def poll(cls, context: Any) -> bool:
        return isinstance(getattr(context.object, "data", None), bpy.types.Curves)

    def draw(self, context: Any) -> None:
        curves = context.object.data
        layout = self.layout
        layout.use_property_split = True
        for name in StrandcacheSettings.__annotations__:
            layout.prop(curves.strandcache, name)
        if curves.name_full in _faults:
            layout.label(text=_faults[curves.name_full], icon="ERROR")


_CLASSES = (StrandcacheSettings, STRANDCACHE_OT_import, STRANDCACHE_PT_settings)


def _menu(self: Any, _context: Any) -> None:
    self.layout.operator(STRANDCACHE_OT_import.bl_idname, text="Strand cache (.h5)")


def register() -> None:
    """What the add-on brings; nothing where it is there already."""
    if hasattr(bpy.types.Curves, "strandcache"):
        return
    for each in _CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Curves.strandcache = bpy.props.PointerProperty(type=StrandcacheSettings)
    bpy.types.TOPBAR_MT_file_import.append(_menu)
    bpy.app.handlers.frame_change_pre.append(_before_frame)
    bpy.app.handlers.frame_change_post.append(_after_frame)


def unregister() -> None:
    bpy.app.handlers.frame_change_post.remove(_after_frame)
    bpy.app.handlers.frame_change_pre.remove(_before_frame)
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
    del bpy.types.Curves.strandcache
    for each in reversed(_CLASSES):
        bpy.utils.unregister_class(each)
    for path in list(_open_caches):
        _forget(path)
