"""What is wrong with a SITE.toml, in parts: the file, the key, the rule and the remedy."""

import re
from dataclasses import dataclass

# As every message about settings begins: FILE: KEY: …, where a key may be behind the point and the alarm that it
# belongs to, and what an alarm lacks has no key.
_WORD, _NAMED = r"[A-Za-z_][\w.\[\]-]*", r"(?: '[^']*'|\[\d+\])"
_VALUE = r"(?: = [^:]*)?: "
_ALARM = rf"alarm{_NAMED}(?:: {_WORD}(?={_VALUE}))?"
_FORM = re.compile(rf"(?P<file>.*?\.toml): (?P<key>(?:point{_NAMED}: )?(?:{_ALARM}|{_WORD})){_VALUE}", re.S)


@dataclass(frozen=True, slots=True)
class SettingsFault:
    """text: the whole message, with the rule and the remedy; file, key: of what is wrong, None where it is not one."""

    text: str
    file: str | None = None
    key: str | None = None

    @classmethod
    def of(cls, text: str) -> "SettingsFault":
        """A message in parts."""
        match = _FORM.match(text)
        return cls(text, match["file"], match["key"]) if match else cls(text)

    def to_dict(self) -> dict[str, str | None]:
        """As the interface shows it."""
        return {"text": self.text, "file": self.file, "key": self.key}
