"""From a motor's data sheet to a motor file: `read` numbers, `convert` a `Sheet`, `yaml_text`."""

from mfpcc_experiments.datasheet.conversion import Motor, Sheet, convert, yaml_text
from mfpcc_experiments.datasheet.quantities import Quantity, SheetError, quantity, read

__all__ = [
    "Motor",
    "Quantity",
    "Sheet",
    "SheetError",
    "convert",
    "quantity",
    "read",
    "yaml_text",
]
