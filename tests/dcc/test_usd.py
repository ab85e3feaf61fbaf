"""Caches as USD, read back by usd-core and looked at by its validators, which usdchecker runs."""

import numpy as np
import pytest
from conftest import make_cache, run_strandcache

import strandcache

pytest.importorskip("pxr", reason="usd-core is not installed; scripts/dcc-packages.sh build/dcc does it")
from pxr import Usd, UsdGeom, UsdValidation  # noqa: E402


def open_valid(path):
    """The stage, after all validators of USD have found nothing in it."""
    stage = Usd.Stage.Open(str(path))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    names = {validator.GetMetadata().name for validator in validators}
    assert {
        "usdGeomValidators:StageMetadataChecker",
        "usdValidation:CompositionErrorTest",
        "usdUtilsValidators:MissingReferenceValidator",
    } <= names
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert not errors, [(error.GetName(), error.GetMessage()) for error in errors]
    return stage


def check_samples(curves, cache, vertices=slice(None)):
    for frame in cache:
        points = np.array(curves.GetPointsAttr().Get(frame.number))
        np.testing.assert_array_equal(points, frame.positions[vertices])
        np.testing.assert_array_equal(
            np.array(curves.GetVelocitiesAttr().Get(frame.number)), frame.velocities[vertices]
        )
        low, high = np.array(curves.GetExtentAttr().Get(frame.number))
        assert (low <= points.min(axis=0) - 4.9e-5).all() and (high >= points.max(axis=0) + 4.9e-5).all()
        np.testing.assert_allclose([low, high], [points.min(axis=0), points.max(axis=0)], atol=6e-5)


def test_the_strands_are_linear_curves_with_a_sample_for_each_frame(tmp_path, sample):
    run = run_strandcache("to-usd", sample, tmp_path / "a.usdc")
    assert run.returncode == 0, run.stderr
    stage = open_valid(tmp_path / "a.usdc")
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert stage.GetTimeCodesPerSecond() == 24 and stage.GetFramesPerSecond() == 24
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (3, 8)
    assert stage.GetDefaultPrim().GetPath() == "/hair"
    curves = UsdGeom.BasisCurves(stage.GetPrimAtPath("/hair/strands"))
    assert curves.GetTypeAttr().Get() == "linear" and curves.GetWrapAttr().Get() == "nonperiodic"
    assert curves.GetPointsAttr().GetTimeSamples() == [3, 4, 5, 6, 7, 8]
    assert list(curves.GetWidthsAttr().Get()) == [np.float32(1e-4)] and curves.GetWidthsInterpolation() == "constant"
    primvars = UsdGeom.PrimvarsAPI(curves)
    with strandcache.Cache(sample) as cache:
        np.testing.assert_array_equal(curves.GetCurveVertexCountsAttr().Get(), np.diff(cache.offset))
        check_samples(curves, cache)
        for name, values, interpolation in (
            ("strand_id", np.arange(200), "uniform"),
            ("region", cache.strand_region, "uniform"),
            ("st", cache.root_uv, "uniform"),
            ("rest", cache.rest, "vertex"),
        ):
            primvar = primvars.GetPrimvar(name)
            np.testing.assert_array_equal(primvar.Get(), values)
            assert primvar.GetInterpolation() == interpolation
        assert list(primvars.GetPrimvar("region_names").Get()) == ["top", "tail", "Stirnzöpfchen"]


def test_long_shots_go_into_value_clips(tmp_path, sample):
    run = run_strandcache("to-usd", sample, tmp_path / "long.usda", "--frames-per-clip", "4")
    assert run.returncode == 0, run.stderr
    assert sorted(p.name for p in (tmp_path / "long.clips").iterdir()) == [
        "long.0003.usdc",
        "long.0007.usdc",
        "long.manifest.usda",
    ]
    stage = open_valid(tmp_path / "long.usda")
    curves = UsdGeom.BasisCurves(stage.GetPrimAtPath("/hair/strands"))
    assert set(curves.GetPointsAttr().GetTimeSamples()) == {3, 4, 5, 6, 7, 8}
    with strandcache.Cache(sample) as cache:
        check_samples(curves, cache)
        assert list(curves.GetPointsAttr().Get(1)) == list(
            curves.GetPointsAttr().Get(3)
        )  # before the shot its first frame holds


def test_each_region_can_be_a_curve_set(tmp_path, sample):
    run = run_strandcache("to-usd", sample, tmp_path / "a.usd", "--by-region", "--frames", "4-6", "--width", "1e-4")
    assert run.returncode == 0, run.stderr
    stage = open_valid(tmp_path / "a.usd")
    names = [str(prim.GetName()) for prim in stage.GetPrimAtPath("/hair").GetChildren()]
    assert len(names) == 3 and names[:2] == ["top", "tail"]
    with strandcache.Cache(sample) as cache:
        for name, region in zip(names, cache.regions):
            curves = UsdGeom.BasisCurves(stage.GetPrimAtPath(f"/hair/{name}"))
            assert curves.GetPointsAttr().GetTimeSamples() == [4, 5, 6]
            np.testing.assert_array_equal(curves.GetPointsAttr().Get(5), cache.at(5).region(region.name))
            np.testing.assert_array_equal(UsdGeom.PrimvarsAPI(curves).GetPrimvar("strand_id").Get(), region.strands)


def test_what_cannot_be_written_is_told(tmp_path, sample):
    def refused(code, *words):
        run = run_strandcache("to-usd", sample, *words)
        assert (
            run.returncode == code and run.stderr.startswith("strandcache: error: ") and run.stderr.count("\n") == 1
        ), run.stderr
        return run.stderr

    assert "has to end in .usd" in refused(2, tmp_path / "a.abc")
    assert "there is no folder" in refused(5, tmp_path / "none/a.usdc")
    assert "has no frame to write" in refused(2, tmp_path / "a.usdc", "--frames", "20-30")
    assert "it has to be above 0" in refused(2, tmp_path / "a.usdc", "--width", "0")
    assert "it has to be 1 or more" in refused(2, tmp_path / "a.usdc", "--frames-per-clip", "0")
    assert "cannot be written" in refused(5, "/proc/a.usdc")
    (tmp_path / "b.clips").write_text("")
    assert "b.clips" in refused(5, tmp_path / "b.usdc", "--frames-per-clip", "2")


def test_a_frame_that_is_not_finite_ends_the_export(tmp_path):
    import h5py

    path = make_cache(tmp_path / "a.h5", 20, 1, 3)
    with h5py.File(path, "r+") as file:
        file["frames/position"][1, 5, 0] = np.nan
    with strandcache.Cache(path) as cache, pytest.raises(
        strandcache.CacheError, match="of frame 2 has a value that is not finite"
    ):
        strandcache.to_usd(cache, tmp_path / "a.usdc")
    assert not (tmp_path / "a.usdc").exists()
