"""Truth for tests and demonstrations: motions, beams, scenes, cameras and sensors whose answer is known exactly."""
