"""A page in the browser that shows a result, or a training as it goes."""

from gsjax.viewer.page import check_port
from gsjax.viewer.watch import view, watch

__all__ = ["check_port", "view", "watch"]
