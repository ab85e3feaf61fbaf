"""VTK opens a cache as it is, through /VTKHDF in the same file; ParaView reads with the same code."""

import subprocess

import h5py
import numpy as np
import pytest
from conftest import MAKE_CACHE, make_cache

pytest.importorskip("vtkmodules", reason="vtk is not installed; scripts/dcc-packages.sh build/dcc does it")
from vtkmodules.util.numpy_support import vtk_to_numpy  # noqa: E402
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline  # noqa: E402
from vtkmodules.vtkIOHDF import vtkHDFReader  # noqa: E402


@pytest.fixture
def reader(sample):
    reader = vtkHDFReader()
    assert reader.CanReadFile(str(sample))
    reader.SetFileName(str(sample))
    reader.UpdateInformation()
    return reader


def test_strands_are_polylines_at_the_times_of_the_frames(reader, sample):
    times = reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    with h5py.File(sample, "r", locking=False) as file:
        assert times == tuple(file["frames/time"][:]) and len(times) == 6
        offset = file["strands/offset"][:]
        for index in (0, 5, 2, 3):
            reader.UpdateTimeStep(times[index])
            hair = reader.GetOutput()
            assert hair.GetClassName() == "vtkPolyData"
            assert hair.GetNumberOfCells() == hair.GetNumberOfLines() == 200
            np.testing.assert_array_equal(vtk_to_numpy(hair.GetPoints().GetData()), file["frames/position"][index])
            np.testing.assert_array_equal(vtk_to_numpy(hair.GetLines().GetOffsetsArray()), offset)
            np.testing.assert_array_equal(vtk_to_numpy(hair.GetLines().GetConnectivityArray()), np.arange(offset[-1]))
            region = vtk_to_numpy(hair.GetCellData().GetArray("region"))
            np.testing.assert_array_equal(region, file["strands/region"][:])
            velocity = vtk_to_numpy(hair.GetPointData().GetArray("velocity"))
            np.testing.assert_array_equal(velocity, file["frames/velocity"][index])


def test_a_picture_shows_the_strands_where_they_are(reader, tmp_path):
    pytest.importorskip("vtkmodules.vtkRenderingOpenGL2")
    from vtkmodules.vtkIOImage import vtkPNGWriter
    from vtkmodules.vtkRenderingCore import (
        vtkActor,
        vtkPolyDataMapper,
        vtkRenderer,
        vtkRenderWindow,
        vtkWindowToImageFilter,
    )

    reader.UpdateTimeStep(5 / 24)
    points = vtk_to_numpy(reader.GetOutput().GetPoints().GetData())
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    mapper, actor, renderer, window = vtkPolyDataMapper(), vtkActor(), vtkRenderer(), vtkRenderWindow()
    mapper.SetInputConnection(reader.GetOutputPort())
    mapper.ScalarVisibilityOff()
    actor.SetMapper(mapper)
    actor.GetProperty().LightingOff()
    renderer.AddActor(actor)
    window.SetOffScreenRendering(True)
    window.SetSize(200, 200)
    window.AddRenderer(renderer)
    camera = renderer.GetActiveCamera()
    camera.ParallelProjectionOn()
    camera.SetParallelScale(1)  # half the height in metres
    camera.SetFocalPoint(*middle)
    camera.SetPosition(*(middle + [0, 0, 5]))
    renderer.ResetCameraClippingRange()
    window.Render()
    still = vtkWindowToImageFilter()
    still.SetInput(window)
    still.Update()
    writer = vtkPNGWriter()
    writer.SetFileName(str(tmp_path / "still.png"))
    writer.SetInputConnection(still.GetOutputPort())
    writer.Write()
    pixels = vtk_to_numpy(still.GetOutput().GetPointData().GetScalars()).reshape(200, 200, -1)[..., 0] > 0
    rows, columns = np.nonzero(pixels)  # from below
    expected = (points[:, :2] - middle[:2]) * 100 + 100
    for found, wanted in ((columns, expected[:, 0]), (rows, expected[:, 1])):
        assert abs(found.min() - wanted.min()) < 3 and abs(found.max() + 1 - wanted.max()) < 3


def test_without_frames_or_unfinished_there_is_no_view(tmp_path):
    subprocess.run([MAKE_CACHE, tmp_path / "a.h5", "50", "1", "3", "leave"], check=True)
    make_cache(tmp_path / "b.h5", 50, 1, 0)
    for name in "a.h5.part", "b.h5":
        with h5py.File(tmp_path / name, "r", locking=False) as file:
            assert "VTKHDF" not in file
