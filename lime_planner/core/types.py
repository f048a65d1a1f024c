"""Names of the arrays that signatures speak of; shapes, units and frames stand in the docstrings."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

#: Numbers: configurations, points, transforms, lengths, costs.
Array = npt.NDArray[np.float64]
#: Points and fields that are stored by the million.
Float32 = npt.NDArray[np.float32]
Int16 = npt.NDArray[np.int16]
Int32 = npt.NDArray[np.int32]
Int64 = npt.NDArray[np.int64]
UInt8 = npt.NDArray[np.uint8]
Bool = npt.NDArray[np.bool_]
