"""What a refusal says first of a scale factor that no camera which looks at a structure has."""

# mm/px is distance × pixel pitch ÷ focal length: 500 is a phone's wide lens (0.7 mm/px a metre at 1920 px) 700 m away,
# where a tracker's 0.01 px are 5 mm. Beyond it the ratio is that of two things that do not move alike.
LARGEST_M_PER_PX = 0.5


def of_no_camera(scale_m_per_px: float) -> str:
    """A sentence where a scale factor is out of any camera's reach, else empty."""
    if abs(scale_m_per_px) <= LARGEST_M_PER_PX:
        return ""
    return (
        "Check camera.direction first (with two files: --direction): no camera that looks at a structure has "
        f"{1e3 * scale_m_per_px:.3g} mm/px (at most {1e3 * LARGEST_M_PER_PX:g}), so that the motion is likely along "
        "the other image axis. "
    )
