"""How structures move and shake, and what sensors of motion and acceleration say of it."""
