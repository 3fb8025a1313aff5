"""What Home Assistant learns of a site's points by MQTT: a retained message for each of their figures.

https://www.home-assistant.io/integrations/mqtt/#mqtt-discovery: the topic is PREFIX/sensor/NODE/OBJECT/config.
"""

import hashlib
import json
import re
from collections.abc import Sequence

from midspan._version import __version__
from midspan.settings.site import MqttSettings

# Summaries come once a second; a figure that is older than a minute is shown as unavailable.
EXPIRE_S = 60
LENGTH: dict[str, object] = {
    "device_class": "distance",
    "unit_of_measurement": "mm",
    "state_class": "measurement",
    "suggested_display_precision": 3,
    "expire_after": EXPIRE_S,
}
# Key, name after the point's, topic below the point's, field of its JSON, further keys.
FIGURES: tuple[tuple[str, str, str, str, dict[str, object]], ...] = (
    ("displacement", "displacement", "summary", "mean_mm", LENGTH),
    ("std", "standard deviation", "summary", "std_mm", LENGTH),
    ("status", "status", "state", "status", {}),
)


def announcements(settings: MqttSettings, site: str, points: Sequence[str]) -> dict[str, str]:
    """Topics and payloads; none where `discovery` is left out."""
    if settings.discovery is None:
        return {}
    root, node = f"{settings.prefix}/v1/{site}", f"midspan_{_plain(site)}"
    device = {"identifiers": [node], "name": site, "manufacturer": "midspan", "sw_version": __version__}
    found = {}
    for point in points:
        for key, name, topic, field, further in FIGURES:
            config = {
                "name": f"{point} {name}",
                "unique_id": f"{node}_{point}_{key}",
                "state_topic": f"{root}/{point}/{topic}",
                "value_template": f"{{{{ value_json.{field} }}}}",
                "availability_topic": f"{root}/available",
                "device": device,
                **further,
            }
            found[f"{settings.discovery}/sensor/{node}/{point}_{key}/config"] = json.dumps(config)
    return found


def _plain(site: str) -> str:
    """A site's name of letters, digits, - and _, which is another one for another site."""
    plain = re.sub(r"[^A-Za-z0-9_-]", "-", site)
    return plain if plain == site else f"{plain}-{hashlib.blake2b(site.encode(), digest_size=3).hexdigest()}"
