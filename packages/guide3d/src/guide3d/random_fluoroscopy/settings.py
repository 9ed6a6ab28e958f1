"""Settings of random fluoroscopy: how often a thing is drawn, and from which ranges its size and darkness come."""

from __future__ import annotations

from guide3d.setting_kinds import Grey, PixelDistance, Pixels, Positive, Share, settings


@settings
class FluoroscopySettings:
    """What random images are like. Lengths are px of a whole image.

    Attributes:
        image_px: side of a whole image, of which a tile is a window.
        mask_px: width of the strip along a wire's centre line that its mask covers, whatever the wire's own width.
        no_wire: share of images without a wire; some of these show a catheter.
        two_devices: share of images with a wire in which there is a second wire or a separate catheter.
        catheter: share of images with a wire in which a catheter lies over it or beside it.
        along_edge: share of wires that ride along a tube's wall or a plate's edge for a part of their course.
        in_vessel: share of wires around which a vessel is drawn, empty or filled.
        given_course: share of wires that follow one of the given courses, where there are any.
        narrowest_px, widest_px: range of a wire's width.
        weakest, strongest: range of a wire's transmission, the share of the X-rays that it lets through.
        tip_change: share of wires whose last part is darker, softer, wider or thinner than the rest.
        beads: share of wires with beads on or beside them.
        markers: share of wires and catheters with radio-opaque bands.
        clutter: factor of the number of tubes, plates, rods, marks and bones; 0: none.
        anatomy: share of images of a body: bones, ribs, gas and tissue; the others are of a phantom.
        contrast: share of images with vessels full of contrast medium.
        background: share of images over one of the given backgrounds, where there are any.
        field: share of images with the edge of a round, square or collimated field.
        noise: largest standard deviation of the noise, grey levels at the image's brightest place.
        blur_px: largest blur by focus and detector, standard deviation.
        jpeg: share of images with the blocks of JPEG.
        near_tip: share of tiles around a wire's tip.
        near_wire: share of tiles around another place of a wire; the others lie anywhere.
    """

    image_px: Pixels = 1024
    mask_px: PixelDistance = 6.0
    no_wire: Share = 0.15
    two_devices: Share = 0.12
    catheter: Share = 0.22
    along_edge: Share = 0.4
    in_vessel: Share = 0.35
    given_course: Share = 0.4
    narrowest_px: PixelDistance = 1.2
    widest_px: PixelDistance = 4.5
    weakest: Share = 0.93
    strongest: Share = 0.58
    tip_change: Share = 0.45
    beads: Share = 0.2
    markers: Share = 0.2
    clutter: Positive = 1.0
    anatomy: Share = 0.35
    contrast: Share = 0.15
    background: Share = 0.3
    field: Share = 0.75
    noise: Grey = 7.0
    blur_px: PixelDistance = 1.3
    jpeg: Share = 0.3
    near_tip: Share = 0.3
    near_wire: Share = 0.35

    def __post_init__(self) -> None:
        """Refuses ranges that are empty."""
        if self.narrowest_px > self.widest_px:
            raise ValueError(f"narrowest_px must not exceed widest_px, got {self.narrowest_px} and {self.widest_px}")
        if not 0 < self.strongest <= self.weakest:
            raise ValueError(f"0 < strongest <= weakest is expected, got {self.strongest} and {self.weakest}")
        if self.near_tip + self.near_wire > 1:
            raise ValueError(f"near_tip + near_wire must not exceed 1, got {self.near_tip + self.near_wire}")
