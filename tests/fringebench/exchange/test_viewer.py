"""Viewed and converted files hold what the originals hold, in the units of the format."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from PIL import Image

import decode
import scenes
from decode.reconstruction import AxisPhase
from evaluation.output.cloud import triangles
from fringebench.exchange.conversion import convert
from fringebench.exchange.viewer import read_view, write_view
from fringebench.verbs import run
from scenes.support.errors import FileError
from tests.conftest import Call

KINDS = ("transport", "stack", "truth", "reconstruction")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small run."""
    out = tmp_path_factory.mktemp("run")
    small = {"camera.resolution": [96, 72], "sampling.samples": 4, "sensor.psf": "none"}
    run(scenes.load("bench", small), out)
    return out


@pytest.fixture(scope="module")
def rec(folder: Path) -> decode.Reconstruction:
    return decode.Reconstruction.read(folder / "reconstruction.exr")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("suffix", [".png", ".html"])
def test_every_kind_of_file_can_be_viewed(
    folder: Path, tmp_path: Path, kind: str, suffix: str
) -> None:
    out = tmp_path / f"view{suffix}"
    source = folder / f"{kind}.exr"
    write_view(read_view(source), source, out)
    if suffix == ".png":
        image = Image.open(out)
        assert min(image.size) > 300
        assert len(np.unique(np.asarray(image.convert("L")))) > 50
    else:
        text = out.read_text()
        assert f"({kind})" in text
        assert text.count("<img") >= 3
        # Surfaces and the pixel inspector need it.
        assert ("Plotly" in text) == (kind != "transport")


def test_view_shows_errors_only_with_a_truth(folder: Path) -> None:
    source = folder / "reconstruction.exr"
    plain, compared = read_view(source), read_view(source, folder / "truth.exr")
    assert len(compared.panels) == len(plain.panels) + 1
    with pytest.raises(FileError, match="only a reconstruction"):
        read_view(folder / "stack.exr", folder / "truth.exr")


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_height_image_gives_the_heights_back(
    folder: Path, tmp_path: Path, rec: decode.Reconstruction, suffix: str
) -> None:
    out = tmp_path / f"height{suffix}"
    convert(folder / "reconstruction.exr", out)
    level = cv2.imread(str(out), cv2.IMREAD_UNCHANGED)
    assert level is not None
    assert level.dtype == np.uint16
    with Image.open(out) as image:
        said = image.text["Description"] if suffix == ".png" else image.tag_v2[270]
    # As a reader of the sentence would: "height_mm = A + B * number"
    offset, step = (float(said.split()[i]) for i in (2, 4))
    np.testing.assert_array_equal(level > 0, rec.valid)
    height = offset + step * level[rec.valid]
    # Half a step of rounding, and that of float32.
    assert np.abs(height - rec.height_mm[rec.valid]).max() <= 0.5 * step * (1 + 1e-3)
    span = float(np.ptp(rec.height_mm[rec.valid]))
    assert step <= 5.0 * span / 65534, "coarser than 16 bits need"


def test_mesh_is_the_measured_surface(
    folder: Path, tmp_path: Path, rec: decode.Reconstruction
) -> None:
    used = np.unique(triangles(rec))
    assert len(used) > 0.99 * rec.valid.sum()
    for suffix in (".ply", ".obj", ".glb"):
        out = tmp_path / f"surface{suffix}"
        convert(folder / "reconstruction.exr", out)
        mesh = trimesh.load(out, process=False, force="mesh")
        # glTF is in metres with y up.
        heights = mesh.vertices[:, 1] * 1e3 if suffix == ".glb" else mesh.vertices[:, 2]
        heights = heights[np.unique(mesh.faces)]
        np.testing.assert_allclose(heights, rec.height_mm[rec.valid][used], atol=1e-5)
        up = mesh.face_normals[:, 1 if suffix == ".glb" else 2]
        assert (up > 0).all(), "triangles face away from the camera"


def test_mesh_has_no_triangles_across_hidden_walls(folder: Path, tmp_path: Path) -> None:
    convert(folder / "truth.exr", tmp_path / "truth.ply")
    mesh = trimesh.load(tmp_path / "truth.ply", process=False)
    # The step's walls are vertical, and the camera, 300 mm above, looks down within 4 degrees: pixels are 0.42 mm here,
    # the wall 1.5 mm; the cap's rim rises 45 degrees at most.
    tilt = np.rad2deg(np.arccos(mesh.face_normals[:, 2]))
    assert tilt.max() < 85.0 + 4.0
    assert 0.97 < len(mesh.faces) / (2 * 95 * 71) <= 1.0


def test_point_cloud_has_errors_and_no_triangles(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "cloud.ply"
    convert(folder / "reconstruction.exr", out, folder / "truth.exr", points=True)
    header = out.read_bytes().split(b"end_header")[0].decode()
    assert "element face" not in header
    assert "scalar_error_mm" in header


def test_gltf_scene_is_in_metres_with_y_up_and_labelled(tmp_path: Path) -> None:
    convert("bench", tmp_path / "bench.glb")
    drawn = trimesh.load(tmp_path / "bench.glb")
    low, high = drawn.bounds
    # A plate of 60 mm x 50 mm, a cap of 2.5 mm.
    np.testing.assert_allclose((high - low)[[0, 2]], [0.060, 0.050], rtol=1e-6)
    assert high[1] == pytest.approx(0.0025, rel=1e-4)
    names = {node.split("-", 1)[1] for node in drawn.graph.nodes_geometry}
    assert names == {"base", "cap", "step", "ink", "solder"}


@pytest.mark.parametrize(
    ("material", "gray", "alpha", "roughness", "metallic"),
    [
        ({"kind": "diffuse", "reflectance": 0.3}, 0.3, 1.0, 1.0, 0.0),
        # As many grains are dark as are bright.
        ({"kind": "printed", "dark": 0.1, "bright": 0.6}, 0.35, 1.0, 1.0, 0.0),
        ({"kind": "glossy", "reflectance": 0.2, "roughness": 0.16}, 0.2, 1.0, 0.4, 0.0),
        # At normal incidence a metal of the index n reflects |(n - 1) / (n + 1)|^2.
        (
            {"kind": "conductor", "eta": 0.6, "k": 2.8, "roughness": 0.09},
            abs((0.6 + 2.8j - 1.0) / (0.6 + 2.8j + 1.0)) ** 2,
            1.0,
            0.3,
            1.0,
        ),
        ({"kind": "dielectric", "roughness": 0.25}, 1.0, 0.3, 0.5, 0.0),
    ],
)
def test_gltf_material_looks_like_the_scene_s(
    tmp_path: Path,
    material: dict[str, Any],
    gray: float,
    alpha: float,
    roughness: float,
    metallic: float,
) -> None:
    """In glTF the roughness that a picture shows, GGX's, is a material's number squared."""
    own = {"materials": {"own": material}, "objects.1.material": "own"}
    convert("bench", tmp_path / "bench.glb", overrides=own)
    drawn = trimesh.load(tmp_path / "bench.glb")
    (look,) = (g.visual.material for n, g in drawn.geometry.items() if n.endswith("-cap"))
    # Colours are bytes.
    np.testing.assert_allclose(look.baseColorFactor / 255.0, [gray] * 3 + [alpha], atol=0.5 / 255)
    assert (look.roughnessFactor, look.metallicFactor) == pytest.approx((roughness, metallic))
    assert look.alphaMode == ("OPAQUE" if alpha == 1.0 else "BLEND")


@pytest.mark.parametrize(
    ("source", "output", "said"),
    [
        ("stack.exr", "a.ply", "fringebench export"),
        ("transport.exr", "a.ply", "takes a reconstruction"),
        ("reconstruction.exr", "a.jpg", "written as .png"),
        ("bench", "a.png", "a scene is written as .glb"),
        ("missing.exr", "a.png", "does not exist"),
    ],
)
def test_refused_conversion_leaves_no_file(
    folder: Path, tmp_path: Path, source: str, output: str, said: str
) -> None:
    path = folder / source if source.endswith(".exr") else source
    with pytest.raises(FileError, match=said):
        convert(path, tmp_path / output)
    assert list(tmp_path.iterdir()) == []


def test_view_and_convert_answer_in_json(folder: Path, tmp_path: Path, call: Call) -> None:
    for name in ("view", "convert"):
        out = tmp_path / f"{name}.png"
        status, said, _ = call(name, folder / "reconstruction.exr", "-o", out, "--json")
        assert status == 0
        assert json.loads(said)["file"] == str(out)
        assert out.stat().st_size > 1000


def test_heights_of_unknown_order_are_shown_as_such(tmp_path: Path) -> None:
    shape = (12, 16)
    phase = np.zeros(shape, np.float32)
    rec = decode.Reconstruction(
        height_mm=np.ones(shape, np.float32),
        sigma_mm=np.full(shape, 1e-3, np.float32),
        modulation_dn=np.full(shape, 50.0, np.float32),
        offset_dn=np.full(shape, 90.0, np.float32),
        reason=np.full(shape, decode.Reason.ORDER_UNKNOWN, np.uint8),
        exposure=np.zeros(shape, np.uint8),
        phases={"column": AxisPhase(20.0, phase, np.ones(shape, np.int32))},
        settings={"resolved": {"order": "known only up to whole turns"}},
    )
    rec.write(tmp_path / "rec.exr")
    view = read_view(tmp_path / "rec.exr")
    assert ["caution", rec.order_note] in view.facts
    shown = {panel.title: panel for panel in view.panels}
    assert "Height" not in shown and "Absolute phase" not in shown
    # Its shape is known, and drawn; that it may be off is in the caption.
    for title in ("Height up to whole fringes", "Phase up to whole turns"):
        assert np.isfinite(shown[title].values).all()
    assert "whole fringes" in shown["Height up to whole fringes"].caption
