"""Results in some six lines that fit a terminal of 80 columns, from the plain values of each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

Values = Mapping[str, Any]
Row = tuple[str, ...]
_MISSING = "–"


def law_lines(content: Values) -> list[str]:
    """What a law states on arms that are built by their tolerances, and on that of the file."""
    built = content["built_by_tolerances"]
    exact = content["as_the_file"]
    both = (built, exact)
    rows: list[Row] = [("", "as built", "as its file")]
    rows.append(("contacts that are answered", *(_of_all(one, "answered") for one in both)))
    rows.append(("stated, and wrong", *(_wrong(one) for one in both)))
    rows.append(("places off, median", *(_error(one, "place_mm", "mm") for one in both)))
    rows.append(("forces off, median", *(_error(one, "lateral_n", "N") for one in both)))
    rows.append(
        ("forces in their 95 % intervals", *(_of_all(one, "force_coverage95") for one in both))
    )
    rows.append(("false contacts, untouched", *(_false_contacts(one) for one in both)))
    return _columns(rows)


def network_lines(content: Values) -> list[str]:
    """A network of one contact, beside the bound that the sensors' noise sets."""
    single = content["single"]
    bound = content["bound"]
    rows: list[Row] = [
        ("", "network", "at best"),
        ("segment right", percent(single["contact_accuracy"]), ""),
        ("direction off, mean", *_pair(single, bound, "direction_mae_deg", "°")),
        ("force off, mean", *_pair(single, bound, "magnitude_mae_n", " N")),
        ("force off, rms", *_pair(single, bound, "magnitude_rmse_n", " N")),
        ("forces in their 95 % intervals", percent(single["coverage95"]), ""),
    ]
    return _columns(rows)


def comparison_lines(content: Values) -> list[str]:
    """The estimator on its three settings, and the networks beside it."""
    rows: list[Row] = [("", "right", "direction off", "force off", "of the bound")]
    for setting, errors in content["single"].items():
        rows.append(_compared(f"estimator, {_plain(setting)}", errors))
    for network, settings in content["peers"].items():
        for setting, errors in settings.items():
            rows.append(_compared(f"{_plain(network)}, {_plain(setting)}", errors))
    several = content["multi"]
    accuracy = percent(several["recognition_accuracy"])
    off_n = _number(_mean(several["magnitude_mae_n"]), " N")
    over = _number(_mean(several["magnitude_mae_n"]) / _mean(several["bound_mae_n"]), " ×")
    rows.append(("several contacts", accuracy, "", off_n, over))
    return _columns(rows)


def table2_lines(content: Values) -> list[str]:
    """One line for each load that was hung on the physical arm; its direction was 180°."""
    rows: list[Row] = [("segment", "hung", "estimated", "95 % interval", "direction")]
    for row in content["rows"]:
        low_n, high_n = row["magnitude_ci95_n"]
        right = "" if row["segment"] == row["true_segment"] else f", as {row['segment']}"
        rows.append(
            (
                f"{row['true_segment']}{right}",
                f"{row['true_magnitude_n']:.2f} N",
                f"{row['magnitude_n']:.2f} N ({row['magnitude_error']:+.1%})",
                f"{low_n:.2f} to {high_n:.2f} N",
                f"{row['angle_deg']:.1f}°",
            )
        )
    return _columns(rows)


def recorded_lines(content: Values, links: Sequence[str]) -> list[str]:
    """The errors of each model on known loads, by link of these names and in all."""
    lines = []
    for model, errors in content.items():
        rows: list[Row] = [(str(model)[-36:], "loads", "link right", "direction off", "force off")]
        for segment, each in errors["by_segment"].items():
            link = links[int(segment) - 1].replace("_", " ")
            rows.append((f"  {link}", *_load_errors(each)))
        rows.append(("  all", *_load_errors(errors["all"])))
        lines += _columns(rows)
        within = percent(errors["all"]["errors"]["magnitude_coverage95"])
        lines.append(f"  forces in their 95 % intervals: {within}")
    return lines


def training_lines(content: Values) -> list[str]:
    """What `train` has made, and its errors on samples that it has not seen."""
    lines = [
        f"wrote {content['out']}: {content['network']}, {content['parameters']:,} parameters",
        f"trained for {content['training_seconds']:.0f} s; epochs: {content['epochs']}, the best "
        f"is number {content['best_epoch']}",
    ]
    single = content.get("single")
    if single:
        errors = single["errors"]
        lines += [
            f"on {single['samples']:,} samples that it has not seen:",
            f"  segment right {percent(single['contact_accuracy'])}",
            f"  direction off by {_number(errors['direction_mae_deg'], '°')}, force by "
            f"{_number(errors['magnitude_mae_n'], ' N')} (means)",
            f"  forces in their 95 % intervals {percent(errors['magnitude_coverage95'])}",
        ]
    return lines


def arm_lines(content: Values) -> list[str]:
    """What an arm is: segments, cables, sensors, what it bears, what it lists."""
    segments = content["segments"]
    cables = content["cables"]
    sensors = content["sensors"]
    bears = content["bears"]
    length_m = sum(segments["length_m"])
    mass_kg = sum(segments["mass_kg"])
    step = "" if sensors["step_n"] is None else f", steps of {sensors['step_n']:g} N"
    effects = ", ".join(effect["effect"] for effect in content["effects"])
    scatter_n = content["unloaded_scatter_n"]
    built = (
        "it finds no rest" if scatter_n is None else f"it reads {scatter_n:.2g} N otherwise (RMS)"
    )
    return [
        f"{content['identity']} in {content['file']}",
        f"{segments['count']} segments, {length_m:g} m and {mass_kg:g} kg in all",
        f"{len(cables)} cables of {_range(cables, 'stiffness_n_m')} N/m, pretension "
        f"{_range(cables, 'pretension_n')} N",
        f"sensors: {sensors['rate_hz']:g} Hz, noise {sensors['noise_std_n']:g} N{step}",
        f"bears {_least(bears['greatest_n'])} N across any segment, sags by "
        f"{bears['sag_deg']:.3g}°",
        f"tolerances: built so, {built}",
        f"effects: {effects or 'none'}",
        *content.get("questions", []),
    ]


def model_lines(content: Values) -> list[str]:
    """What a model file is for, what it takes and gives."""
    metadata = content["metadata"]
    inputs = ", ".join(port["name"] for port in content["inputs"])
    outputs = ", ".join(port["name"] for port in content["outputs"][:4])
    more = len(content["outputs"]) - 4
    return [
        f"{metadata['network']} for {metadata['arm_identity']}",
        f"{content['file']}",
        f"{content['size_bytes'] / 1e6:.2f} MB, made by",
        f"  {metadata['command']}",
        f"takes {inputs}",
        f"gives {outputs}" + (f" and {more} more" if more > 0 else ""),
    ]


def effect_lines(content: Values) -> list[str]:
    """A list of effects, each with what it is about, by what they act on."""
    effects = content["effects"]
    width = max(len(name) for name in effects)
    lines = []
    for part in dict.fromkeys(effect["acts_on"] for effect in effects.values()):
        lines.append(f"on the {part}:")
        for name, effect in effects.items():
            if effect["acts_on"] == part:
                lines.append(f"  {name:{width}}  {effect['about']}")
    return lines


def percent(share: float | None) -> str:
    """A share as per cent; a dash where there is none."""
    return _MISSING if share is None else f"{100.0 * share:.1f} %"


def _of_all(statements: Values, key: str) -> str:
    return percent(statements["touched"]["all"][key])


def _wrong(statements: Values) -> str:
    touched = statements["touched"]["all"]
    return f"{touched['wrong']} of {touched['contacts']:,}"


def _error(statements: Values, quantity: str, unit: str) -> str:
    return _number(statements[quantity]["all"]["median"], f" {unit}")


def _false_contacts(statements: Values) -> str:
    return f"{statements['false_contacts']} of {statements['untouched']:,}"


def _pair(network: Values, bound: Values, key: str, unit: str) -> tuple[str, str]:
    return _number(network[key], unit), _number(bound[key], unit)


def _compared(label: str, errors: Values) -> Row:
    return (
        label,
        percent(errors["contact_accuracy"]),
        _number(errors["direction_mae_deg"], "°"),
        _number(errors["magnitude_mae_n"], " N"),
        _number(errors.get("mae_over_bound"), " ×"),
    )


def _load_errors(metrics: Values) -> Row:
    errors = metrics["errors"]
    return (
        f"{errors['contacts']:,}",
        percent(errors["contact_accuracy"]),
        _number(errors["direction_mae_deg"], "°"),
        _number(errors["magnitude_mae_n"], " N"),
    )


def _number(value: float | None, unit: str) -> str:
    return _MISSING if value is None else f"{value:.3g}{unit}"


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _range(rows: Iterable[Values], key: str) -> str:
    values = [row[key] for row in rows]
    low = min(values)
    high = max(values)
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def _least(values: Sequence[float | None]) -> str:
    known = [value for value in values if value is not None]
    return f"{min(known):.3g}" if known else _MISSING


def _plain(key: str) -> str:
    return key.replace("_", " ")


def _columns(rows: Sequence[Row]) -> list[str]:
    """Rows as lines: the first column to the left, the others to the right."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [f"{row[0]:{widths[0]}}"]
        cells += [f"{cell:>{width}}" for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append("  ".join(cells).rstrip())
    return lines
