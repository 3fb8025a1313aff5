"""From a camera's frames to its targets' displacement."""
