"""The former place of `Calibration`, which scripts name."""

from runtime.geometry.calibration import Calibration as Calibration
