"""What is learnt of cameras beside the accelerometer."""
