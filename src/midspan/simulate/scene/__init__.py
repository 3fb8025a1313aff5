"""What a camera or a thermal camera sees: textures, light, panels, things in front, noise."""
