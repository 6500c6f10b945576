import numpy as np

from runtime.health.frame_health import FrameHealth


def test_both_sensors_are_checked_against_the_frames_before():
    random = np.random.default_rng(0)
    health = FrameHealth()
    depth = random.uniform(1, 50, (60, 80)).astype(np.float32)
    for _ in range(5):
        rgb = random.integers(0, 256, (60, 80, 3), dtype=np.uint8)
        assert health.check(rgb, depth) == ()
    depth[:, :20] = 0
    assert health.check(rgb, depth) == ("image_frozen", "lidar_sector_lost")
    assert health.check(np.zeros_like(rgb), np.zeros_like(depth)) == ("image_black",)
