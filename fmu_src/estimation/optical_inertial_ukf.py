"""Pose from an optical tracker and an inertial unit by the unscented filter."""

from fmu_src.estimation.error_state import Unscented
from fmu_src.estimation.optical_inertial import SPACE, make

MODEL = make("OpticalInertialUkf", Unscented(SPACE))
