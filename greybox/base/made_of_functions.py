"""Values that are stated by functions, and still can be pickled."""

from __future__ import annotations

from typing import Any


class MadeOfFunctions:
    """A value that is stated by functions, often lambdas, which `pickle` refuses: they travel by value, as to another process."""

    def restate(self) -> tuple[Any, ...]:
        """The function that makes it anew, and its arguments."""
        raise NotImplementedError

    def __reduce__(self) -> tuple[Any, ...]:
        from greybox.base.parallel.local_pool import (  # slow to import, and a command's help needs none of it
            pack,
            unpack,
        )

        return unpack, (pack(self),)

    def __copy__(self) -> Any:
        make, values = self.restate()
        return make(*values)

    def __deepcopy__(self, memo: Any) -> Any:
        return self.__copy__()  # what it is made of does not change
