"""The check of a record by the annotations of its fields."""

from typing import Any, get_type_hints

from beartype.door import die_if_unbearable
from jaxtyping import jaxtyped


def check_fields(record: Any) -> None:
    """Raise where a field is not what its annotation states, or a dimension has two sizes."""
    with jaxtyped("context"):
        for name, hint in get_type_hints(type(record)).items():
            die_if_unbearable(getattr(record, name), hint)
