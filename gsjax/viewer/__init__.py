"""A page in the browser that shows a result, or a training as it goes."""

from gsjax.io.packages import require

require("viser")  # A missing one is one line, before the modules below import it.

from gsjax.viewer.page import check_port  # noqa: E402
from gsjax.viewer.watch import view, watch  # noqa: E402

__all__ = ["check_port", "view", "watch"]
