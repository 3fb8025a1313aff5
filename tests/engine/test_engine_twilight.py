"""The sun over a place, and the published rule of day, night and the hours about nautical twilight."""

from datetime import UTC, datetime

import pytest

from midspan.papers.printed.switching import Place, Switch, light_of_day, sun_elevation_deg

MINUTE_NS = 60 * 10**9
POLE, GREENWICH = Place(90.0, 0.0), Place(51.4769, 0.0)


def utc(*parts):
    return int(datetime(*parts, tzinfo=UTC).timestamp()) * 10**9


@pytest.mark.parametrize(
    ("instant", "declination"),
    [
        (utc(1992, 10, 13), -7.785),  # Meeus, Astronomical Algorithms, example 25.a
        (utc(2023, 3, 20, 21, 24), 0.0),  # equinox
        (utc(2023, 6, 21, 14, 58), 23.436),  # solstice: the obliquity of the year
    ],
)
def test_at_the_pole_the_elevation_is_the_declination(instant, declination):
    assert sun_elevation_deg(instant, POLE) == pytest.approx(declination, abs=0.02)


def test_the_sun_passes_the_meridian_by_the_equation_of_time():
    # 2023-11-03: 16 min 27 s ahead of the mean sun. Elevations 3 h before and after the passage differ by what the
    # declination falls by (0.31° a day) alone.
    noon = utc(2023, 11, 3, 11, 43, 33)
    before, after = (sun_elevation_deg(noon + sign * 180 * MINUTE_NS, GREENWICH) for sign in (-1, 1))
    assert before - after == pytest.approx(0.31 * 6 / 24, abs=0.04)


def test_the_hours_about_nautical_twilight_are_the_transition():
    # At the equator at an equinox the sun sinks by 15° an hour, straight down: 12° below the horizon 48 min after 18 h
    # by the sun, which runs 7.4 min behind the clock.
    equator, dusk = Place(0.0, 0.0), utc(2023, 3, 20, 18, 0) + round((48 + 7.4) * MINUTE_NS)
    assert sun_elevation_deg(dusk, equator) == pytest.approx(-12.0, abs=0.05)
    reported = {minutes: light_of_day(dusk + minutes * MINUTE_NS, equator) for minutes in (-62, -58, 0, 58, 62)}
    assert reported == {-62: "day", -58: "transition", 0: "transition", 58: "transition", 62: "night"}


def test_stamps_that_are_no_dates_leave_it_to_the_matches():
    assert light_of_day(3600 * 10**9, GREENWICH) == "transition"


def test_by_day_vision_measures_by_night_infrared_and_in_between_the_one_with_more_matches():
    switch, events = Switch(("camera", "infrared"), Place(0.0, 0.0)), []
    for tick in range(0, 3 * 3600, 2):
        now = utc(2023, 3, 20, 17, 30) + round(0.95 * tick * 1e9)  # the means are over 2 s
        # Infrared has more matches by day, vision by night.
        for sensor, matches in (("camera", 10.0 if tick < 3600 else 50.0), ("infrared", 30.0)):
            reported = switch.push(sensor, now, matches)
            events += [] if reported is None else [(0.95 * tick / 60.0, reported.text)]
    # In the transition, from 17:55:24 to 19:55:24, the matches decide: infrared, then vision; the night is infrared's.
    assert [text for _, text in events] == [
        "camera → infrared: 30 matches next to 10",
        "infrared → camera: 50 matches next to 30",
        "camera → infrared: night",
    ]
    assert [minute for minute, _ in events] == pytest.approx([25.4, 57.0, 145.4], abs=0.5)
