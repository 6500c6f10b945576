"""Sources that turn recordings into frames: folders, bags, KITTI's layouts and videos."""
