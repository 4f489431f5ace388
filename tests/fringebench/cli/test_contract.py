"""The command line as scripts use it: documented options, answers in JSON, refusals with status 2."""

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import decode
import render
import scenes
from fringebench.gate.decoders import resolve
from scenes import PhaseShift, Stack
from scenes.support.errors import FileError, OutsideDecoderError
from tests.conftest import Call
from tests.decode.synthetic import calibrated_stack, hills, rig

SMALL = ("--set", "camera.resolution=[64,48]", "--set", "sampling.samples=2")


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call) -> Call:
    """The command line in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return call


def test_every_stage_answers_in_json(run: Call, tmp_path: Path) -> None:
    def answer(*words: str) -> Any:
        done = run(*words, "--json")
        assert done.status == 0, done.err
        return json.loads(done.out)

    traced = answer("render", "step", *SMALL, "--seed", "3", "--truth", "truth.exr")
    assert traced == {"transport": "transport.exr", "truth": "truth.exr", "samples": 2, "depth": 3}
    exposed = answer("expose", "transport.exr", "--seed", "3")
    assert exposed["shape"] == list(Stack.read(tmp_path / "stack.exr").frames.shape)
    decoded = answer("decode", "stack.exr")
    assert sum(decoded["reasons"].values()) == pytest.approx(1.0)
    assert answer("evaluate", "reconstruction.exr", "truth.exr")["scene"] == "step"
    frames = answer("export", "stack.exr", "-o", "frames")
    assert (tmp_path / frames["manifest"]).is_file()
    assert answer("scenes", "step", *SMALL)["camera"]["resolution"] == [64, 48]
    printed = run("scenes", "step", *SMALL)
    assert scenes.parse(printed.out).camera.resolution == (64, 48)


def test_invalid_exposure_time_is_refused_and_the_stack_kept(run: Call, tmp_path: Path) -> None:
    assert run("render", "step", *SMALL).status == 0
    (tmp_path / "stack.exr").write_text("precious")
    for time in ("0", "-3", "nan", "inf"):
        done = run("expose", "transport.exr", "--exposure-ms", time)
        assert done.status == 2
        assert "each above 0" in done.err
        assert "Traceback" not in done.err
    assert (tmp_path / "stack.exr").read_text() == "precious"


def test_traced_light_is_exposed_with_other_sensor_and_patterns_only(
    run: Call, tmp_path: Path
) -> None:
    assert run("render", "step", *SMALL).status == 0
    few = ("sensor.bits=8", "exposures.auto.level_dn=120", "patterns.steps=3")
    done = run("expose", "transport.exr", *(f"--set={key}" for key in few), "--json")
    assert done.status == 0, done.err
    assert json.loads(done.out)["shape"] == [1, 9, 48, 64]
    stack = Stack.read(tmp_path / "stack.exr")
    assert stack.frames.dtype == np.uint8
    assert stack.sensor.bits == 8
    assert scenes.parse(stack.scene).sensor == stack.sensor
    before = (tmp_path / "stack.exr").read_bytes()
    for setting, said in (
        ("camera.fx_px=3", "trace again"),
        ("sensor.bots=8", "did you mean 'bits'"),
        ("patterns.periods_px=[17.0]", "trace the scene again"),
    ):
        done = run("expose", "transport.exr", "--set", setting)
        assert (done.status, said in done.err) == (2, True), done.err
    assert (tmp_path / "stack.exr").read_bytes() == before


def test_unwritable_output_is_refused_before_the_work(
    run: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_light(*_: object, **__: object) -> None:
        pytest.fail("light was traced")

    monkeypatch.setattr("render.trace", no_light)
    for words in (
        ("render", "step", "-o", "missing/t.exr"),
        ("render", "step", "--truth", "missing/g.exr"),
        ("calibrate", "step", "-o", "missing/rig.yml"),
    ):
        done = run(*words)
        assert done.status == 2
        assert "cannot write 'missing/" in done.err
    assert not list(tmp_path.iterdir())


def test_damaged_file_is_named_as_given(run: Call, tmp_path: Path) -> None:
    for content in (b"", b"no picture", bytes([0x76, 0x2F, 0x31, 0x01])):
        (tmp_path / "mine.exr").write_bytes(content)
        for command in ("decode", "expose", "view"):
            done = run(command, "mine.exr")
            assert done.status == 2
            assert "'mine.exr' is truncated, damaged or no OpenEXR file" in done.err
            assert "python_buffer" not in done.err


def test_numpy_numbers_are_accepted_and_written(tmp_path: Path) -> None:
    file = tmp_path / "a.exr"
    scene = scenes.load("step", {"camera.resolution": np.array([32, 24])})
    light = render.trace(scene, seed=np.uint32(3), samples=np.int64(2), depth=np.int16(1))  # type: ignore[arg-type]
    light.write(file)
    assert render.Transport.read(file).seed == 3
    stack = calibrated_stack(
        rig(size=(32, 24)), hills((32, 24)), PhaseShift(periods_px=(16.0, 80.0))
    )
    choices: dict[str, Any] = {
        "fusion": "single",
        "exposure": np.int64(0),
        "projector": np.int64(0),
        "min_modulation_dn": np.float32(8.0),
        "max_order_residual": np.float32(0.25),
        "height_range_mm": np.array([-1.0, 2.0]),
    }
    rec = decode.reconstruct(stack, **choices)
    rec.write(file)
    settings = decode.Reconstruction.read(file).settings
    assert {name: settings[name] for name in choices} == {
        name: value.tolist() if isinstance(value, (np.generic, np.ndarray)) else value
        for name, value in choices.items()
    }
    with pytest.raises(FileError, match="not JSON"):
        dataclasses.replace(rec, settings={"rule": object()}).write(file)
    assert decode.Reconstruction.read(file).settings == settings


def test_frames_without_calibration_are_decoded_and_phases_are_no_heights(
    run: Call, tmp_path: Path
) -> None:
    assert run("render", "step", *SMALL, "--truth", "g.exr").status == 0
    assert run("expose", "transport.exr").status == 0
    stack = Stack.read(tmp_path / "stack.exr")
    dataclasses.replace(stack, calibration=None).write(tmp_path / "bare.exr")
    said = run("decode", "bare.exr").err
    # The options of the command, not the arguments of the function.
    assert "--c-px-per-mm" in said and "--height phase" in said and "c_px_per_mm" not in said
    assert run("decode", "bare.exr", "--c-px-per-mm", "4").status == 0
    rec = decode.Reconstruction.read(tmp_path / "reconstruction.exr")
    assert np.isfinite(rec.height_mm[rec.valid]).all()
    assert run("decode", "bare.exr", "--height", "phase").status == 0
    done = run("evaluate", "reconstruction.exr", "g.exr", "-o", "scores.json")
    assert (done.status, "only phases" in done.err) == (2, True)
    assert not (tmp_path / "scores.json").exists()
    for target in ("a.ply", "a.png"):
        done = run("convert", "reconstruction.exr", "-o", target)
        assert (done.status, "Traceback" in done.err) == (2, False)
    for words in (("reconstruction.exr",), ("reconstruction.exr", "--truth", "g.exr")):
        for target in ("a.html", "a.png"):
            done = run("view", *words, "-o", target)
            assert done.status in {0, 2}, done.err
            assert "Traceback" not in done.err


def test_stage_prints_what_it_wrote(run: Call, tmp_path: Path) -> None:
    said = run("render", "step", *SMALL, "--truth", "g.exr").out.splitlines()
    assert said == [
        "transport.exr: 64 x 48 px, 7 channels, 2 samples per pixel",
        "g.exr: base, step",
    ]
    done = run("expose", "transport.exr", "--exposure-ms", "2", "--exposure-ms", "0.5")
    assert done.out == "stack.exr: 12 frames at 2, 0.5 ms, 64 x 48 px\n"
    measured, *lost = run("decode", "stack.exr").out.removesuffix("\n").split("; ")
    shares = decode.Reconstruction.read(tmp_path / "reconstruction.exr").reason_fractions()
    assert measured == f"reconstruction.exr: {shares['ok']:.1%} of the pixels measured"
    assert lost == [f"{name} {share:.2%}" for name, share in shares.items() if name != "ok"]


def test_printed_path_is_not_wrapped_and_keeps_its_brackets(run: Call) -> None:
    folder = "[red]" + "long-" * 30
    done = run("run", "step", *SMALL, "-o", folder)
    assert f"files in {folder}  (" in done.out
    (Path(folder) / "reconstruction.exr").rename("[bold]r.exr")
    done = run("evaluate", "[bold]r.exr", f"{folder}/truth.exr")
    assert "[bold]r.exr" in done.out
    done = run("compare", "step", *SMALL, "--strategies", "single", "--repeats", "1", "-o", folder)
    assert f"files in {folder}\n" in done.out
    done = run("export", f"{folder}/stack.exr", "-o", folder)
    assert done.out == f"{folder}/manifest.toml\n"
    done = run("import", f"{folder}/manifest.toml", "-o", f"{folder}/i.exr", "--force")
    assert f"{folder}/i.exr: 1 exposures, 12 frames, 64 x 48 px, calibrated\n" in done.out


WRITERS = {
    "exr": "import OpenEXR; OpenEXR.File({}, {'height_mm': h}).write(output)",
    "npy": "np.save(open(output, 'wb'), h)",
    "tif": "import cv2; open(output, 'wb').write(cv2.imencode('.tif', h)[1].tobytes())",
}


@pytest.mark.parametrize("kind", WRITERS)
def test_program_may_write_heights_to_the_given_path(kind: str, tmp_path: Path) -> None:
    program = tmp_path / "decoder.py"
    program.write_text(
        "import sys; import numpy as np; output = sys.argv[2]\n"
        f"h = np.arange(12, dtype=np.float32).reshape(3, 4)\n{WRITERS[kind]}\n"
    )
    stack = calibrated_stack(rig(size=(4, 3)), hills((4, 3)), PhaseShift(periods_px=(16.0,)))
    answer = resolve(f"{sys.executable} {program} {{stack}} {{output}}")(stack)
    assert (answer.height_mm == np.arange(12).reshape(3, 4)).all()
    program.write_text("import sys; open(sys.argv[2], 'w').write('heights')")
    with pytest.raises(OutsideDecoderError, match="wrote 0"):
        resolve(f"{sys.executable} {program} {{stack}} {{output}}")(stack)
