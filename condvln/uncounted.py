"""Arrays in kernels whose references are not counted.

A kernel counts a reference of each array of its arguments when it begins and when it ends, with atomic instructions,
unless it has one way out and calls nothing that may fail. With the dozen arrays of a navmesh, that was two thirds of a
shortest path or a walk.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Protocol, TypeVar, cast

from numba.core import types
from numba.core.errors import TypingError
from numba.core.types.containers import BaseTuple
from numba.extending import box, intrinsic, models, register_model

__all__ = ["UncountedArray", "keep", "uncounted"]

V = TypeVar("V")

_Array: Any = types.Array  # its methods are typed for its own class alone


class _SameValue(Protocol):
    def __call__(self, value: V, /) -> V: ...


class UncountedArray(_Array):  # type: ignore[misc]
    """The type of arrays in a kernel whose references are not counted, and of views of them."""

    def __init__(self, dtype: Any, ndim: int, layout: str, readonly: bool = False, aligned: bool = True) -> None:
        name = f"uncounted {_Array(dtype, ndim, layout, readonly, None, aligned).name}"
        super().__init__(dtype, ndim, layout, readonly, name, aligned)

    def copy(
        self, dtype: Any = None, ndim: int | None = None, layout: str | None = None, readonly: bool | None = None
    ) -> Any:
        """Return the type of a view. For the type of a new array, numba states whether that is read-only: it is
        counted.
        """
        found = super().copy(dtype, ndim, layout, readonly)
        if readonly is not None:
            return found
        return UncountedArray(found.dtype, found.ndim, found.layout, not found.mutable, found.aligned)

    def unify(self, typing: Any, other: Any) -> Any:
        """Refuse that one name means a counted array and an uncounted one, of which nothing would free the first."""
        found = super().unify(typing, other)
        if found is None or not isinstance(other, UncountedArray):
            return None
        return UncountedArray(found.dtype, found.ndim, found.layout, not found.mutable, found.aligned)

    def can_convert_to(self, typing: Any, other: Any) -> Any:
        """Return how arrays of this type become arrays of another one: only if these are uncounted, too."""
        return super().can_convert_to(typing, other) if isinstance(other, UncountedArray) else None


@register_model(UncountedArray)
class _UncountedModel(models.ArrayModel):  # type: ignore[misc]
    """The same fields as those of any array, none of which has references to count."""

    def traverse(self, builder: Any) -> list[Any]:
        return []

    def inner_models(self) -> list[Any]:
        return []


@box(UncountedArray)  # type: ignore[untyped-decorator]
def _refuse(kind: Any, native: Any, context: Any) -> Any:
    raise TypingError("an uncounted array can't be returned to Python")


def _type_without_counts(kind: Any) -> Any:
    if isinstance(kind, UncountedArray | types.Number | types.Boolean):
        return kind
    if isinstance(kind, types.Array):
        return UncountedArray(kind.dtype, kind.ndim, kind.layout, not kind.mutable, kind.aligned)
    if isinstance(kind, BaseTuple):
        parts = [_type_without_counts(part) for part in kind.types]
        return BaseTuple.from_types(parts, getattr(kind, "instance_class", None))
    raise TypingError(f"references to {kind} are counted")


def _native_without_counts(context: Any, builder: Any, kind: Any, native: Any) -> Any:
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value=native)
        array.meminfo = array.meminfo.type(None)
        array.parent = array.parent.type(None)
        return array._getvalue()
    if isinstance(kind, BaseTuple):
        parts = [
            _native_without_counts(context, builder, part, builder.extract_value(native, k))
            for k, part in enumerate(kind.types)
        ]
        return context.make_tuple(builder, _type_without_counts(kind), parts)
    return native


@intrinsic  # type: ignore[untyped-decorator]
def _uncounted(typing: object, value: Any) -> Any:
    def changed(context: Any, builder: Any, signature: Any, native: Any) -> Any:
        return _native_without_counts(context, builder, value, native[0])

    return _type_without_counts(value)(value), changed


@intrinsic  # type: ignore[untyped-decorator]
def _keep(typing: object, value: Any) -> Any:
    return types.none(value), lambda context, builder, signature, native: context.get_dummy_value()


uncounted: Final = cast("_SameValue", _uncounted)
"""Return, within a kernel, the same array or tuple of arrays, whose references are not counted.

A kernel that Python calls hands on its arrays uncounted: the caller holds them until it returns. They and their views
can't be returned to Python; arrays that the kernel made itself must be kept, see `keep`.
"""

keep: Final = cast("Callable[[object], None]", _keep)
"""Keep, within a kernel, an array or tuple of arrays until here: it is freed after the last line that uses it, and the
use of its uncounted twin does not count.
"""
