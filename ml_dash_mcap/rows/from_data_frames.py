"""Converts columns of pandas, polars and pyarrow into numpy arrays and lists, with None for what is missing.

None of these libraries is imported: if there is one of their columns, its library is loaded already.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_NUMBERS = "fiub"
_MISSING = ("NAType", "NaTType")
_SPELLED = ("Interval", "Period")
_LIBRARIES = ("pandas", "polars", "pyarrow")


def plain(column: Any) -> Any:
    """Return one value a row as an array or a list; whatever is no column of these libraries as it is.

    - Numbers and booleans are an array, a list if some are missing. NaN stays NaN where numbers are numpy's.
    - Text, categories, times and objects are a list. pandas' NaN, None, NA and NaT are None there.
    - A frame of several columns is a vector a row.

    Args:
        column: Any; of a dict, each of its columns.
    """
    if isinstance(column, Mapping):
        return {key: plain(inner) for key, inner in column.items()}
    library = library_of(column)
    if library == "pandas":
        return _of_pandas(column)
    if library == "polars" and hasattr(column, "null_count") and hasattr(column, "to_list"):
        return column.to_list() if column.null_count() or not column.dtype.is_numeric() else column.to_numpy()
    if library == "pyarrow" and hasattr(column, "to_pylist"):
        return _of_pyarrow(column)
    return column


def library_of(value: Any) -> str | None:
    """Return which of these libraries a value is of; None for any other."""
    # By the name of its module, so that no library has to be imported to ask.
    library = type(value).__module__.partition(".")[0]
    return library if library in _LIBRARIES else None


def is_missing(value: Any) -> bool:
    """Whether a value is pandas' NA or NaT."""
    return type(value).__name__ in _MISSING and library_of(value) == "pandas"


def plain_value(value: Any) -> Any:
    """Return the plain value of a value of these libraries; pandas' times and spans are text in ISO 8601.

    Raises:
        TypeError: It is neither a column nor a single value.
    """
    if is_missing(value):
        return None
    column = plain(value)
    if column is not value:
        return column
    if hasattr(value, "as_py"):
        return value.as_py()
    if hasattr(value, "isoformat"):
        return value.isoformat()
    if type(value).__name__ in _SPELLED:
        return str(value)
    raise TypeError(f"Type is not JSON serializable: {type(value).__name__}")


def _of_pandas(column: Any) -> Any:
    if hasattr(column, "columns"):  # a frame
        array = column.to_numpy()
        if array.dtype.kind in _NUMBERS:
            return array
        return [list(row) for row in zip(*(_listed(column.iloc[:, at]) for at in range(array.shape[1])), strict=True)]
    dtype = getattr(column, "dtype", None)
    if dtype is None or not hasattr(column, "isna"):
        return column
    kind = getattr(dtype, "kind", "O")
    if hasattr(dtype, "byteorder"):  # a dtype of numpy
        return column.to_numpy() if kind in _NUMBERS else _listed(column)
    if kind in _NUMBERS and not column.isna().any():
        return column.to_numpy(dtype=_numpy_type(dtype))
    return _listed(column)


def _numpy_type(dtype: Any) -> Any:
    """Return the numpy type of a nullable one, of a sparse one, or of one that pyarrow holds."""
    return getattr(dtype, "numpy_dtype", None) or getattr(dtype, "subtype", None)


def _listed(column: Any) -> list[Any]:
    """Return pandas' values one by one, None where one is missing."""
    values = column.astype(object)
    missing = column.isna()
    return [None if is_gap else value for value, is_gap in zip(values.tolist(), missing.tolist(), strict=True)]


def _of_pyarrow(column: Any) -> Any:
    is_number = str(column.type).startswith(("int", "uint", "half", "float", "double", "bool"))
    if not is_number or column.null_count:
        return column.to_pylist()
    return column.to_numpy() if hasattr(column, "chunks") else column.to_numpy(zero_copy_only=False)
