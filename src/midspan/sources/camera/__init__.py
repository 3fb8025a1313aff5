"""Frames of videos, folders of images and stacks of arrays: luma only, with time stamps."""
