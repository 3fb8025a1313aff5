"""A displacement sensor of a recording, and what is learnt of it."""
