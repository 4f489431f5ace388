"""A rig from what data sheets say: sensor and focal length of the camera, throw ratio and offset of the projector."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from scenes import Calibration
from scenes.rig.devices import LookAt, Pinhole, Resolution
from scenes.rig.projectors import PinholeProjector
from scenes.support.errors import SceneError, nearest

NUMBER = r"(-?[\d.]+)"
CAMERA = {
    "columns x rows": r"(\d+) ?[x×] ?(\d+)",
    "pixel pitch": rf"{NUMBER} ?[uµμ]m",
    "focal length": rf"f ?=? ?{NUMBER} ?mm",
    "f-number": rf"f ?/ ?{NUMBER}",
}
PROJECTOR = {
    "columns x rows": CAMERA["columns x rows"],
    "throw": rf"throw ?{NUMBER}",
    "offset": rf"offset ?{NUMBER} ?%",
}
# Columns, rows and pixel pitch of chips. IMX249, IMX250, IMX267, IMX273: technical documentation of the mvBlueFOX3
# (Matrix Vision), tables "Sensor and image data". IMX342: the camera of the scene `measured-rig`.
CHIPS = {
    "imx249": "1936x1216, 5.86 um",
    "imx250": "2464x2056, 3.45 um",
    "imx267": "4112x2176, 3.45 um",
    "imx273": "1456x1088, 3.45 um",
    "imx342": "6464x4852, 3.45 um",
}
# Throw and offset belong to an optical module, not to its chip. This one is the projector of the scene `measured-rig`, by its
# published calibration (Koch, Piadyk et al. 2021): fx / columns, and how far the principal point is from the middle.
MODULES = {"dlp4710lc": "1920x1080, throw 1.4807, offset 103.03 %"}


@dataclass(frozen=True)
class DataSheetRig:
    """Camera above z = 0, projector next to it, and what the sheet says of the sensor."""

    calibration: Calibration
    sensor: dict[str, float]


def rig_of_sheets(
    camera: str, projector: str, distance_mm: float, baseline_mm: float
) -> DataSheetRig:
    """The rig of two data sheets: both devices `distance_mm` above z = 0, both images centred there.

    Parameters
    ----------
    camera
        For example ``"2448x2048, 3.45 um, f 16 mm, f/8"``; a chip of `CHIPS` replaces size and pitch.
    projector
        For example ``"1280x800, throw 1.4, offset 100 %"``: throw is distance over image width; at an offset of 100 %
        the image's lower edge is level with the lens, at 0 % its middle is. A module of `MODULES` replaces all three.
    distance_mm
        From the camera's pupil to z = 0, mm, more than 0.
    baseline_mm
        From the camera to the projector along +x, mm, not 0.

    Returns
    -------
    DataSheetRig
        Geometry without distortion, and sensor keys (`pixel_um`, `f_number`).

    Raises
    ------
    SceneError
        For a sheet that cannot be read or lacks a value.

    Examples
    --------
    >>> rig = rig_of_sheets("IMX250, f 16 mm", "1280x800, throw 1.4", 300.0, 100.0)
    >>> round(rig.calibration.camera.fx_px), rig.calibration.projectors[0].fx_px
    (4638, 1792.0)
    """
    if not (distance_mm > 0.0 and baseline_mm != 0.0):
        raise SceneError(
            f"distance {distance_mm:g} mm, baseline {baseline_mm:g} mm: give --distance-mm above 0 and a --baseline-mm"
        )
    eye = _read("--camera", camera, CAMERA, CHIPS)
    light = _read("--projector", projector, PROJECTOR, MODULES)
    need = ("columns x rows", "pixel pitch", "focal length")
    columns, rows, pitch_um, focal_mm = _values("--camera", camera, eye, need)
    fx = focal_mm / (pitch_um * 1e-3)
    size: Resolution = (int(columns), int(rows))
    pose = LookAt(origin_mm=(0.0, 0.0, distance_mm))
    seen = Pinhole(
        resolution=size, pose=pose, fx_px=fx, fy_px=fx, cx_px=columns / 2, cy_px=rows / 2
    )
    columns, rows, throw = _values("--projector", projector, light, ("columns x rows", "throw"))
    shift_px = light.get("offset", (0.0,))[0] / 100.0 * rows / 2.0
    fx = throw * columns
    reach = math.hypot(distance_mm, baseline_mm)
    # Lowered until the image, which is above the axis by its offset, is centred on the world's origin.
    y = -shift_px / fx * reach
    lit = PinholeProjector(
        resolution=(int(columns), int(rows)),
        pose=LookAt(origin_mm=(baseline_mm, y, distance_mm), target_mm=(0.0, y, 0.0)),
        fx_px=fx,
        fy_px=fx,
        cx_px=columns / 2,
        cy_px=rows / 2 + shift_px,
        reference_mm=reach,
    )
    sensor = {"pixel_um": pitch_um}
    if "f-number" in eye:
        sensor["f_number"] = eye["f-number"][0]
    volume = (-0.25 * distance_mm, 0.25 * distance_mm)
    return DataSheetRig(Calibration(camera=seen, projectors=(lit,), height_range_mm=volume), sensor)


def _read(
    option: str, text: str, known: Mapping[str, str], names: Mapping[str, str]
) -> dict[str, tuple[float, ...]]:
    """The values of a sheet by their names, each part of the text matched whole; a word of `names` stands for its sheet."""
    found: dict[str, tuple[float, ...]] = {}
    whole = re.sub(r"\w+", lambda word: names.get(word[0].lower(), word[0]), text)
    for part in filter(None, (part.strip() for part in whole.split(","))):
        for name, pattern in known.items():
            match = re.fullmatch(pattern, part, re.IGNORECASE)
            if match is None:
                continue
            try:
                values = tuple(map(float, match.groups()))
            except ValueError:
                continue
            if name in found:
                raise SceneError(f"{option} '{text}': {name} is given twice; give it once")
            if not (name == "offset" or min(values) > 0.0):
                raise SceneError(f"{option} '{text}': {name} must be more than 0")
            found[name] = values
            break
        else:
            raise SceneError(
                f"{option} '{text}': '{part}' is none of {', '.join(known)}; by name: {nearest(part.lower(), names)} E.g. "
                + (
                    "'2448x2048, 3.45 um, f 16 mm, f/8'"
                    if known is CAMERA
                    else "'1280x800, throw 1.4, offset 100 %'"
                )
            )
    return found


def _values(
    option: str, text: str, found: dict[str, tuple[float, ...]], names: tuple[str, ...]
) -> list[float]:
    """The values of these names in a row; `SceneError` names what is missing."""
    missing = [name for name in names if name not in found]
    if missing:
        raise SceneError(f"{option} '{text}': add the {' and the '.join(missing)}")
    return [value for name in names for value in found[name]]
