"""Types that every layer names."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["FloatArray", "PortType"]


FloatArray = NDArray[np.float64]
PortType = Literal["Real", "Integer", "Boolean"]
