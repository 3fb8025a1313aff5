"""A day outdoors: sun, weather and surfaces as a camera and a thermal camera film them."""
