"""Pose from an optical tracker and an inertial unit by the extended filter."""

from fmu_src.estimation.optical_inertial.model import make
from fmu_src.estimation.optical_inertial.state import SPACE
from fmu_src.filters.error_state import Extended

MODEL = make("OpticalInertialEkf", Extended(SPACE))
