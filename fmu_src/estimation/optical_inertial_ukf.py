"""Pose from an optical tracker and an inertial unit by the unscented filter."""

from fmu_src.estimation.optical_inertial import SPACE, make
from fmu_src.filters.error_state import Unscented

MODEL = make("OpticalInertialUkf", Unscented(SPACE))
