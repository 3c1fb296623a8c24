"""What `cablesense train` prints when it is done."""

from __future__ import annotations

from collections.abc import Iterator

from rich.table import Table

from cablesense_training.train_model import TrainingReport


def training_tables(report: TrainingReport, arm_identity: str) -> Iterator[Table]:
    """The figures on one page; for a single-contact network the errors by force, too."""
    figures = report.figures()
    title = f"{report.path}: {report.network}, arm {arm_identity}"
    summary = Table(title=title, show_header=False)
    summary.add_row("parameters", f"{figures['parameters']:,}")
    summary.add_row("size", f"{figures['bytes'] / 1000:,.0f} kB")
    summary.add_row("epochs (best)", f"{figures['epochs']} ({figures['best_epoch']})")
    summary.add_row("training time", f"{figures['training_seconds']:.0f} s")
    if report.single is not None:
        errors = report.single.errors
        summary.add_row("test samples", f"{report.single.samples:,}")
        summary.add_row("contact accuracy", f"{report.single.contact_accuracy:.2%}")
        summary.add_row("direction MAE", f"{errors.direction_mae_deg:.3f} deg")
        summary.add_row("magnitude MAE", f"{errors.magnitude_mae_n:.3f} N")
        summary.add_row("magnitude RMSE", f"{errors.magnitude_rmse_n:.3f} N")
        summary.add_row("95 % intervals that hold", f"{report.single.coverage95:.1%}")
    for metrics, which in ((report.multi, "all contacts"), (report.multi_firm, "from 5 N")):
        if metrics is not None:
            points = ", ".join(f"{error:.2f}" for error in metrics.magnitude_mae_n)
            summary.add_row(f"{which}: recognised", f"{metrics.recognition_accuracy:.2%}")
            summary.add_row(f"{which}: macro F1", f"{metrics.macro_f1:.4f}")
            summary.add_row(f"{which}: magnitude MAE by segment", f"{points} N")
    yield summary
    if report.single is None:
        return
    bins = Table(title="by force")
    for heading in ("force, N", "contacts", "right segment", "direction MAE", "magnitude MAE"):
        bins.add_column(heading, justify="right")
    for part in report.single.bins:
        errors = part.errors
        bins.add_row(
            f"{part.low_n:g} to {part.high_n:g}",
            f"{errors.contacts:,}",
            f"{errors.contact_accuracy:.2%}",
            f"{errors.direction_mae_deg:.3f} deg",
            f"{errors.magnitude_mae_n:.3f} N",
        )
    yield bins
