"""Why a pixel is not to be trusted: one reason each, the first that applies in the order of `Reason`."""

from enum import IntEnum, unique


@unique
class Reason(IntEnum):
    """Codes of `Reconstruction.reason`."""

    OK = 0
    OUTSIDE_ROI = 1
    """Not asked for."""
    SATURATED = 2
    """The fusion rule found no usable exposure."""
    SHADOW = 3
    """No fringe above the noise, or light that must be stray or comes from beyond a shadow's edge: see `decode.validity.shadow` and
    `decode.validity.epipolar_order`."""
    DARK = 4
    """A fringe, but of too little modulation."""
    ORDER_MISMATCH = 5
    """The periods disagree about the fringe order."""
    NO_HEIGHT = 6
    """The height model has no answer here: an invalid reference pixel, a ray that misses."""
    OUT_OF_VOLUME = 7
    """Height outside the working volume."""
    NOT_A_NUMBER = 8
    """Samples are NaN or infinite."""
    ORDER_UNKNOWN = 9
    """The fringe order is known only up to whole turns, so the height may be off by whole fringes: nothing measured fixes
    it, and `reconstruct` was not asked to scan (``unwrap``, or ``anchor="spatial"``)."""
    MIXED = 10
    """The pixel sees two heights, and reports one that is neither, or brightness changes too much within the blur
    (`decode.validity.error_causes`); or its centre is beside the mirror that it measures (`decode.deflectometry.edges`)."""
    STRAY = 11
    """A third or more of the fine fringes' modulation is lost to light that came by way of other surfaces."""
    NO_IMAGE = 12
    """The surface sends light of the screen to the camera but shows no image of it: the contrast of the finest fringes is
    lost, as by a matt surface, which mixes light of the whole screen."""
    NO_TEXTURE = 13
    """Stereo: brightness changes no more than noise does, so nothing can be matched."""
    NO_MATCH = 14
    """Stereo: no place of the second picture looks alike, several do, or the second camera does not see the point."""

    @property
    def label(self) -> str:
        """The name as text: order-mismatch."""
        return self.name.lower().replace("_", "-")
