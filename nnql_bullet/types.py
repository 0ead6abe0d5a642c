"""Types that several modules share: numbers of options with their bounds, and arrays and tuples of numbers."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
UnitInterval = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]

Bytes = NDArray[np.uint8]
Vector = tuple[float, float, float]
