"""Pose from an optical tracker and an inertial unit by the extended filter."""

from fmu_src.estimation.error_state import Extended
from fmu_src.estimation.optical_inertial import SPACE, make

MODEL = make("OpticalInertialEkf", Extended(SPACE))
