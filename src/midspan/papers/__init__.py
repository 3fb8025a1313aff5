"""The papers' experiments, repeated in simulation: what is measured, and whether their claims hold."""
