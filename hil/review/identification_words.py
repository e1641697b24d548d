"""What the parameters of an identification mean, a sentence for each."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite

from hil.core.identification.parameters import BY_NAME
from hil.core.identification.result import FittedParameter, Identification

EXTENSION_WORDS = {
    "dead_zone": "dead zones of the pumps",
    "curve": "bends of the pumps' curves",
    "delay": "transport delays",
    "datum": "outlets below the tanks' zeros",
    "sensor_gain": "gains of the sensors",
    "sensor_offset": "offsets of the sensors",
    "overflow": "overflow that falls into the tank below",
}


def structure_words(identification: Identification) -> str:
    """What the model has beyond gains, splits, outlets and lags."""
    said = [EXTENSION_WORDS.get(name, name) for name in identification.structure]
    return ", ".join(said) if said else "basic: gains, splits, outlets and lags"


def sentence(parameter: FittedParameter, found: Mapping[str, FittedParameter], voltage_V: float) -> str:
    """What the value means for the rig, compared with the old file.

    found : all parameters by name, for what belongs together. voltage_V : at which flows of pumps are compared.
    """
    row = BY_NAME[parameter.name]
    if parameter.status == "fixed":
        same = "as in the file" if parameter.value == parameter.was else f"the file said {_with_unit(parameter, True)}"
        return f"{_capital(row.meaning)}: {_with_unit(parameter)}, {same}; not estimated."
    if parameter.status == "not identifiable":
        value = _with_unit(parameter)
        kept = f"It stays {value}, as in the file."
        if parameter.value != parameter.was:
            kept = f"The file has a value of {value} that fits them together with the others."
        return f"{_capital(row.meaning)}: the records do not determine it on its own. {kept}"
    text = _SENTENCES[row.group](parameter, row.index + 1)
    if row.group == "k":
        text += _flow(row.index + 1, found, voltage_V)
    return text


def _gain(one: FittedParameter, pump: int) -> str:
    return f"Pump {pump} gives {_change(one, 'more', 'less')} for 1 V than the file said; {_known(one)}."


def _flow(pump: int, found: Mapping[str, FittedParameter], voltage_V: float) -> str:
    """The flow at a voltage, where dead zone or curve have changed, too."""
    parts = [found.get(f"{group}{pump}") for group in ("k", "dead_zone", "curve")]
    others = [one for one in parts[1:] if one is not None]
    if all(one.value == one.was for one in others):
        return ""
    before, after = (_flow_of([_take(one, is_old) for one in parts], voltage_V) for is_old in (True, False))
    if before <= 0.0:
        return ""
    share = after / before - 1.0
    return (
        f" With its dead zone and its curve it gives {abs(share) * 100:.3g} % {'more' if share >= 0.0 else 'less'} at "
        f"{voltage_V:g} V."
    )


def _take(one: FittedParameter | None, is_old: bool) -> float:
    if one is None:
        return 0.0
    return one.was if is_old else one.value


def _flow_of(numbers: list[float], voltage_V: float) -> float:
    gain, dead_zone_V, curve_1_V = numbers
    x = max(0.0, voltage_V - dead_zone_V)
    return gain * x * (1.0 + curve_1_V * x)


def _split(one: FittedParameter, pump: int) -> str:
    return (
        f"{_share(one.value, one)} of the flow of pump {pump} goes to tank {pump}, the rest to tank {5 - pump}; "
        f"the file said {one.was * 100:.4g} %; {_known(one)}."
    )


def _outlet(one: FittedParameter, tank: int) -> str:
    return f"The outlet of tank {tank} is {_change(one, 'larger', 'smaller')} than the file said; {_known(one)}."


def _lag(one: FittedParameter, pump: int) -> str:
    return f"Pump {pump} follows its voltage with a time constant of {_value(one)}; {_file_said(one)}."


def _dead_zone(one: FittedParameter, pump: int) -> str:
    return f"Pump {pump} gives no flow below {_value(one)}; {_file_said(one)}."


def _curve(one: FittedParameter, pump: int) -> str:
    percent = one.value * 5.0 * 100.0
    more = f"{abs(percent):.2g} % {'more' if percent >= 0.0 else 'less'}"
    return (
        f"The curve of pump {pump} bends by {_value(one)}: 5 V above its dead zone it gives {more} than a straight "
        f"one; {_file_said(one)}."
    )


def _delay(one: FittedParameter, pump: int) -> str:
    return f"The flow of pump {pump} arrives after {_value(one)}; {_file_said(one)}."


def _datum(one: FittedParameter, tank: int) -> str:
    return f"The outlet of tank {tank} lies {_value(one)} below the tank's zero; {_file_said(one)}."


def _sensor_gain(one: FittedParameter, tank: int) -> str:
    return f"Sensor {tank} shows {_change(one, 'more', 'less')} V for 1 cm than the file said; {_known(one)}."


def _sensor_offset(one: FittedParameter, tank: int) -> str:
    return f"Sensor {tank} reads {_value(one)} at the tank's zero; {_file_said(one)}."


def _overflow(one: FittedParameter, tank: int) -> str:
    return f"{_share(one.value, one)} of what overflows tank {tank} falls into tank {tank - 2}; {_known(one)}."


_SENTENCES = {
    "k": _gain,
    "gamma": _split,
    "a": _outlet,
    "lag": _lag,
    "dead_zone": _dead_zone,
    "curve": _curve,
    "delay": _delay,
    "datum": _datum,
    "sensor_gain": _sensor_gain,
    "sensor_offset": _sensor_offset,
    "overflow": _overflow,
}


def half_width(one: FittedParameter) -> float:
    """Half of the interval, of the longer half where the value is not in its middle, as at a limit."""
    return max(one.high - one.value, one.value - one.low)


def _change(one: FittedParameter, more: str, less: str) -> str:
    """By how many per cent of the old value."""
    if one.was == 0.0:
        return f"{one.value:.4g} {one.unit} {more}"
    change = one.value / one.was - 1.0
    return f"{abs(change) * 100:.3g} % {more if change >= 0.0 else less}"


def _known(one: FittedParameter) -> str:
    """Half of the interval, in per cent of the value."""
    half = half_width(one)
    if not isfinite(half) or one.value == 0.0:
        return "how well it is known is not known"
    inside = " (the file's value is within that)" if one.low <= one.was <= one.high else ""
    return f"known to {half / abs(one.value) * 100:.2g} %{inside}"


def _value(one: FittedParameter) -> str:
    """Value and half of the interval, in its unit, to the digits of the latter."""
    half = half_width(one)
    return f"{number(one.value, half)} ± {number(half, half)} {one.unit}"


def _file_said(one: FittedParameter) -> str:
    return f"the file said {_with_unit(one, True)}"


def _with_unit(one: FittedParameter, is_old: bool = False) -> str:
    value = one.was if is_old else one.value
    return f"{value:.4g}" + ("" if one.unit == "1" else f" {one.unit}")


def _share(value: float, one: FittedParameter) -> str:
    return f"{number(value * 100, 1000.0 * half_width(one))} %"


def number(value: float, half: float) -> str:
    """A value with the digits that its interval justifies. half : half of the interval's width."""
    if not isfinite(half) or half <= 0.0:
        return f"{value:.4g}"
    places = max(0, -int(f"{half:e}".partition("e")[2]) + 1)
    return f"{value:.{min(places, 9)}f}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
