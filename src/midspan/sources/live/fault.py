"""A source that does not give what it should, with a reason code that the documentation explains."""

from midspan.errors import DataError


class SourceFault(DataError):
    """`code`: one of the reason codes; the text is for people, and holds no secret."""

    def __init__(self, code: str, text: str) -> None:
        super().__init__(text)
        self.code = code
