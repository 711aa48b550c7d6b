"""Numbers of the instrument's design, as a data sheet or a drawing gives them.

Nominal values only: what a maker knows. What a plant adds to them (misalignment, bias, lag) is the
plant's own and stands there.
"""

import numpy as np

STANDARD_GRAVITY = 9.80665
"""Unit g of accelerometer data sheets [m/s2]."""
SITE_GRAVITY = 9.80131
"""Gravity at the site [m/s2] (A04 4.2.1.2)."""
MAGNETIC_FIELD = 50e-6
"""Strength of the earth's field at the site [T] (typical of mid northern latitudes)."""
MAGNETIC_INCLINATION = np.radians(55.0)
"""Dip of the field below the horizon [rad] (A04 4.2.3)."""

D1, D2, D3 = 20.2e-3, 14.3e-3, 116.0e-3
"""Distances between the accelerometer sites [m] (A04 2.54)."""
TIP = (0.0, 0.0, 0.21)
"""Tip in the body frame [m] (180 mm handle, and the shaft)."""

ACCELEROMETER_SCALE = 1.0 / STANDARD_GRAVITY
"""ADXL203 at 5 V: 1 V/g [V.s2/m]."""
ACCELEROMETER_NOISE = 110e-6 * STANDARD_GRAVITY
"""ADXL203 data sheet: 110 ug/sqrt(Hz) [m/s2/Hz0.5]."""
MAGNETOMETER_SCALE = 1e4
"""HMC2003: 1 V/gauss [V/T]."""
MAGNETOMETER_RESOLUTION = 40e-10
"""HMC2003 data sheet: 40 microgauss [T]."""
ZERO_VOLTS = 2.5
"""Output of both sensors at zero input [V]."""
ADC_SPAN = 5.0
"""Full scale of the converter, from 0 V [V]."""
OUTPUT_RESISTANCE, OUTPUT_CAPACITANCE = 32e3, 0.33e-6
"""ADXL203 output filter: 32 kohm with 0.33 uF gives 15.2 Hz."""
SENSOR_LAG = OUTPUT_RESISTANCE * OUTPUT_CAPACITANCE
"""Time constant of that filter [s] (A04 3.2.1.7)."""

PLATFORM_RADIUS = 6.5e-3
"""Base and platform radius of the manipulator [m] (gives A04 Table 6.1)."""
SHAFT_LENGTH = 45e-3
"""Platform centre to tip [m] (gives A04 Table 6.1)."""
LEVER_GAIN = 8.0
"""Stroke amplification of the levers (A04 6.2)."""
STACK_VOLTS = 100.0
"""Largest voltage of a P-885.50 stack [V] (A04 6.2); 0 V and up only."""
STACK_STROKE = 15e-6
"""Its stroke at that voltage [m] (A04 6.2)."""

MARKERS = ((0.035, 0.0, 0.0), (-0.03, 0.045, 0.01), (-0.03, -0.04, -0.005), (0.0, 0.01, -0.06))
"""Places of an optical tracker's markers in B [m] (chosen): sides of 70 to 86 mm, all different, so
that none is mistaken."""
