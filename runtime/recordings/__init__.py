"""Recordings to frames: folders, bags, KITTI, videos."""
