"""Arrays that compiled code borrows from its caller.

Numba counts the references to an array: atomically, for each view of it and each function that it goes through. Over
small matrices that took about 60 % of the estimator's time (`perf`). References to borrowed arrays are not counted:
whoever calls the loop holds them until it returns, so nothing that the loop makes itself may be borrowed.
"""

from typing import Any

from numba.core import types
from numba.extending import intrinsic


@intrinsic
def _borrowed(_, given):  # type: ignore[no-untyped-def]
    return given(given), lambda context, builder, _, values: _lend(context, builder, given, values[0])


# Compiled code calls it with arrays, or tuples of arrays and numbers, that its caller holds; it returns the same.
borrowed: Any = _borrowed


def _lend(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """A value of a Numba type without the pointers by which references are counted."""
    if isinstance(kind, types.BaseTuple):
        inner: Any = kind
        parts = [_lend(context, builder, inner[i], builder.extract_value(value, i)) for i in range(len(inner))]
        return context.make_tuple(builder, kind, parts)
    if not isinstance(kind, types.Array):
        return value
    view = context.make_array(kind)(context, builder, value)
    view.meminfo, view.parent = view.meminfo.type(None), view.parent.type(None)
    return view._getvalue()
