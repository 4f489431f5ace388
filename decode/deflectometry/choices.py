"""Which options make sense with a screen, and which without."""

from decode.options import Options
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError

HEIGHTS = ("two-positions", "integration")


def require_projectors(options: Options) -> None:
    """`DecodeError` for choices that only a screen offers."""
    screen = f"height='{options.height}'" if options.height in HEIGHTS else ""
    if options.known_point is not None:
        screen = "known_point"
    if screen:
        raise DecodeError(
            f"{screen} is for what mirrors a screen, and the stack's calibration has none: leave it out, or use height triangulation, "
            "reference-plane, linear or phase"
        )


def height_by(stack: Stack, options: Options) -> str:
    """How heights are found, one of `HEIGHTS`; `DecodeError` for choices that make no sense with a screen."""
    assert stack.calibration is not None
    known = len(stack.calibration.screens)
    if options.projector is not None and not 0 <= options.projector < known:
        raise DecodeError(
            f"projector is {options.projector}, and the screen has {known} position(s), counted from 0"
        )
    positions = known if options.projector is None else 1
    for name in ("axis", "c_px_per_mm", "reference"):
        if getattr(options, name) is not None:
            raise DecodeError(
                f"{name} is given, but the rig has a screen, whose columns and rows give slopes together: leave it out"
            )
    if options.matcher is not None:
        raise DecodeError(
            f"matcher='{options.matcher}' is for two cameras, and the rig has a screen: leave it out"
        )
    if options.uncertainty != "sensor":
        raise DecodeError(
            f"uncertainty='{options.uncertainty}' is for projectors, and the rig has a screen: leave it out"
        )
    way = options.height or ("two-positions" if positions == 2 else "integration")
    if way not in HEIGHTS:
        raise DecodeError(
            f"height='{way}' is for projectors, and the rig has a screen: use two-positions, or integration"
        )
    if way == "two-positions" and positions < 2:
        raise DecodeError(
            "two-positions needs the screen in two positions, and this is one: use integration with known_point"
        )
    if positions == 1 and options.known_point is None:
        raise DecodeError(
            "one position of the screen leaves the height open: give known_point (row, column, height in mm) on the surface, "
            "or a second position of the screen"
        )
    if positions == 2 and options.known_point is not None:
        raise DecodeError(
            "known_point is for one position of the screen: two measure the height themselves; leave it out"
        )
    return way
