"""Caches as USD: BasisCurves with time-sampled points. Needs usd-core, or the pxr of a host program."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .cache import Cache, Selection

_ALL: tuple[slice, slice] = (slice(None), slice(None))


def to_usd(
    cache: Cache,
    path: str | os.PathLike[str],
    *,
    frames: range | None = None,
    width: float = 1e-4,
    by_region: bool = False,
    frames_per_clip: int | None = None,
) -> None:
    """Writes a .usdc, .usda or .usd with the strands at /hair/strands, or one curve set per region below /hair.

    frames: frame numbers in the scene; left out: all.
    width: diameter of the strands in metres.
    frames_per_clip: for long shots, writes points into value clips of so many frames, NAME.clips/NAME.0001.usdc and
        so on beside the file, so that no more frames than those are in memory at once. Left out: all is in one file.

    Raises CacheError where the cache is damaged, OSError where a file cannot be written, ValueError for what cannot be.
    """
    try:
        from pxr import Tf, Usd
    except ImportError as error:
        raise ImportError("to_usd needs USD's Python package: pip install usd-core") from error
    target = Path(path)
    if target.suffix not in (".usd", ".usda", ".usdc"):
        raise ValueError(f"{target}: has to end in .usd, .usda or .usdc")
    if not width > 0 or not np.isfinite(width):
        raise ValueError(f"a width of {width} m; it has to be above 0")
    if frames_per_clip is not None and frames_per_clip < 1:
        raise ValueError(f"{frames_per_clip} frames in a clip; it has to be 1 or more")
    if not target.parent.is_dir():
        raise FileNotFoundError(f"{target}: there is no folder {target.parent}")
    wanted = [index for index, number in enumerate(cache.numbers) if frames is None or int(number) in frames]
    if not wanted:
        raise ValueError(f"{cache.path}: has no frame to write")
    writer = _Writer(cache, wanted, width, by_region)
    try:
        stage = Usd.Stage.CreateInMemory()
        writer.define(stage)
        if frames_per_clip is None:
            writer.sample(stage, wanted)
        else:
            writer.write_clips(stage, target, frames_per_clip)
        if not stage.GetRootLayer().Export(os.fspath(target)):
            raise OSError(f"{target}: cannot be written")
    except Tf.ErrorException as error:
        raise OSError(f"{target}: cannot be written ({str(error).strip().splitlines()[-1].strip()})") from error


class _Writer:
    def __init__(self, cache: Cache, wanted: list[int], width: float, by_region: bool) -> None:
        self.cache, self.wanted, self.width = cache, wanted, width
        # Name of the curves: what of the strands and of the vertices they show.
        self.curves: dict[str, tuple[Selection, Selection]] = {"strands": _ALL}
        if by_region:
            names = _identifiers(region.name for region in cache.regions)
            self.curves = {
                name: (region.strands, region.vertices)
                for name, region in zip(names, cache.regions)
                if len(cache.offset[:-1][region.strands])
            }

    def times(self, stage: Any, wanted: list[int]) -> None:
        from pxr import UsdGeom

        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(self.cache.fps)
        stage.SetFramesPerSecond(self.cache.fps)
        stage.SetStartTimeCode(int(self.cache.numbers[wanted[0]]))
        stage.SetEndTimeCode(int(self.cache.numbers[wanted[-1]]))

    def define(self, stage: Any) -> None:
        """All that does not change over time."""
        from pxr import Kind, Sdf, Usd, UsdGeom, Vt

        cache = self.cache
        self.times(stage, self.wanted)
        hair = UsdGeom.Xform.Define(stage, "/hair").GetPrim()
        stage.SetDefaultPrim(hair)
        Usd.ModelAPI(hair).SetKind(Kind.Tokens.component)
        hair.SetDocumentation(f"Strandbake {cache.provenance.version}")
        counts = np.diff(cache.offset).astype(np.int32)
        for name, (strands, vertices) in self.curves.items():
            curves = UsdGeom.BasisCurves.Define(stage, f"/hair/{name}")
            curves.CreateTypeAttr(UsdGeom.Tokens.linear)
            curves.CreateWrapAttr(UsdGeom.Tokens.nonperiodic)
            curves.CreateCurveVertexCountsAttr(Vt.IntArray.FromNumpy(counts[strands]))
            curves.CreateWidthsAttr(Vt.FloatArray([self.width]))
            curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)
            primvars = UsdGeom.PrimvarsAPI(curves)

            def primvar(label: str, kind: Any, values: Any, interpolation: Any, primvars: Any = primvars) -> None:
                primvars.CreatePrimvar(label, kind, interpolation).Set(values)

            types, uniform = Sdf.ValueTypeNames, UsdGeom.Tokens.uniform
            ids = np.arange(cache.strand_count, dtype=np.int32)[strands]
            primvar("strand_id", types.IntArray, Vt.IntArray.FromNumpy(ids), uniform)
            primvar(
                "region", types.IntArray, Vt.IntArray.FromNumpy(cache.strand_region[strands].astype(np.int32)), uniform
            )
            primvar(
                "region_names",
                types.StringArray,
                Vt.StringArray([region.name for region in cache.regions]),
                UsdGeom.Tokens.constant,
            )
            if cache.root_uv is not None:
                uv = Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(cache.root_uv[strands]))
                primvar("st", types.TexCoord2fArray, uv, uniform)
            primvar(
                "rest",
                types.Point3fArray,
                Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(cache.rest[vertices])),
                UsdGeom.Tokens.vertex,
            )

    def sample(self, stage: Any, wanted: list[int]) -> None:
        """What changes over time, for some frames."""
        from pxr import UsdGeom, Vt

        for index in wanted:
            frame = self.cache[index]
            for name, (_, vertices) in self.curves.items():
                curves = UsdGeom.BasisCurves(stage.GetPrimAtPath(f"/hair/{name}"))
                points = np.ascontiguousarray(frame.positions[vertices])
                curves.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(points), frame.number)
                room = np.float32(self.width / 2)
                extent = np.stack([points.min(axis=0) - room, points.max(axis=0) + room])
                curves.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(extent), frame.number)
                if self.cache.has_velocities:
                    velocities = np.ascontiguousarray(frame.velocities[vertices])
                    curves.CreateVelocitiesAttr().Set(Vt.Vec3fArray.FromNumpy(velocities), frame.number)

    def write_clips(self, stage: Any, target: Path, frames_per_clip: int) -> None:
        from pxr import Sdf, Usd, UsdGeom, Vt

        folder = target.with_suffix(".clips")
        folder.mkdir(exist_ok=True)
        manifest = Usd.Stage.CreateInMemory()
        first_numbers: list[int] = []
        assets: list[str] = []
        for part in _cut(self.wanted, frames_per_clip):
            clip = Usd.Stage.CreateInMemory()
            self.times(clip, part)
            for name in self.curves:
                clip.OverridePrim(f"/hair/{name}").SetTypeName("BasisCurves")
            self.sample(clip, part)
            first_numbers.append(int(self.cache.numbers[part[0]]))
            file = folder / f"{target.stem}.{first_numbers[-1]:04d}.usdc"
            if not clip.GetRootLayer().Export(os.fspath(file)):
                raise OSError(f"{file}: cannot be written")
            assets.append(f"./{folder.name}/{file.name}")
        for name in self.curves:  # which attributes the clips have
            curves = UsdGeom.BasisCurves(manifest.OverridePrim(f"/hair/{name}"))
            curves.CreatePointsAttr()
            curves.CreateExtentAttr()
            if self.cache.has_velocities:
                curves.CreateVelocitiesAttr()
        file = folder / f"{target.stem}.manifest.usda"
        if not manifest.GetRootLayer().Export(os.fspath(file)):
            raise OSError(f"{file}: cannot be written")
        clips = Usd.ClipsAPI(stage.GetPrimAtPath("/hair"))
        clips.SetClipPrimPath("/hair")
        clips.SetClipAssetPaths(Sdf.AssetPathArray([Sdf.AssetPath(asset) for asset in assets]))
        clips.SetClipManifestAssetPath(Sdf.AssetPath(f"./{folder.name}/{file.name}"))
        clips.SetClipActive(Vt.Vec2dArray([(number, k) for k, number in enumerate(first_numbers)]))
        numbers = self.cache.numbers[self.wanted]
        clips.SetClipTimes(Vt.Vec2dArray([(int(number), int(number)) for number in (numbers[0], numbers[-1])]))


def _cut(wanted: list[int], size: int) -> Iterator[list[int]]:
    return (wanted[first : first + size] for first in range(0, len(wanted), size))


def _identifiers(names: Iterable[str]) -> list[str]:
    """Names as USD takes them, all different."""
    from pxr import Tf

    found: list[str] = []
    for name in names:
        base = Tf.MakeValidIdentifier(re.sub(r"[^A-Za-z0-9_]", "_", name))
        label, k = base, 2
        while label in found:
            label, k = f"{base}_{k}", k + 1
        found.append(label)
    return found
