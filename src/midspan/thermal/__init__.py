"""Radiometric images: from counts to temperature, which temperatures to look at, what the camera itself adds."""
