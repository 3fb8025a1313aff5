"""A live site as it is in the field, on loopback: broker, cameras, sensors, the service itself, and faults of each."""
