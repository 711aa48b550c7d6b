"""Pose from an optical tracker and an inertial unit by the unscented filter."""

from fmu_src.estimation.optical_inertial.model import make
from fmu_src.estimation.optical_inertial.state import SPACE
from fmu_src.filters.error_state import Unscented

MODEL = make("OpticalInertialUkf", Unscented(SPACE))
