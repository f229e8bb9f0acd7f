"""What `meshpoint rig --describe` prints: data sheet, the gearbox as built, and its faults."""

from __future__ import annotations

from collections.abc import Mapping

from rich.table import Table
from rich.text import Text

from meshpoint.dbc.messages import RigFault
from meshpoint.gearbox import GearboxSheet
from meshpoint.gearbox.tables import to_table
from meshpoint.results.output import console
from meshpoint.rig_sim.settings import Preset, RigSettings
from meshpoint.rig_sim.truck.as_built import AsBuilt, draw_as_built, parameters
from meshpoint.rig_sim.truck.faults import KINDS


def describe_rig(sheet: GearboxSheet, settings: RigSettings) -> None:
    """Prints it for people; the same values as JSON are in `simulate --json`."""
    out = console()
    out.print(f"data sheet {sheet.name}, sha256 {sheet.sha256}")
    for line in _flat("", to_table(sheet)):
        out.print(f"  {line}")
    if settings.preset is Preset.THESIS:
        out.print("\npreset thesis: the gearbox is as its sheet says, and has no faults")
        return
    built = draw_as_built(settings.seed, settings.as_built, settings.profile)
    out.print(
        f"\nas built, profile {settings.profile}, seed {settings.seed}, teeth {built.teeth_seed}",
    )
    out.print(parameters_table(built, settings.as_built))
    out.print("\nfaults, by --faults FILE or the bench's frame BenchFault")
    out.print(faults_table())


def parameters_table(built: AsBuilt, fixed_values: Mapping[str, float]) -> Table:
    """Every value of the gearbox as built, and what it could have been drawn from."""
    table = Table("parameter, and what it is", box=None)
    for column in ("default", "as built", "range"):
        table.add_column(column, no_wrap=True)
    for name, parameter in parameters(built.profile).items():
        fixed = " fixed" if name in fixed_values else ""
        table.add_row(
            Text.assemble(f"{name}\n", (parameter.note, "dim")),
            f"{parameter.default:g}",
            f"{built[name]:g}{fixed}",
            f"{parameter.low:g}..{parameter.high:g}",
        )
    return table


def faults_table() -> Table:
    """Every fault that can be asked for."""
    table = Table("number", box=None)
    table.add_column("kind", no_wrap=True)
    for column in ("what goes wrong", "target", "value"):
        table.add_column(column)
    for kind in RigFault:
        said = KINDS[kind]
        table.add_row(str(int(kind)), kind.name.lower(), said.text, said.target, said.value)
    return table


def _flat(prefix: str, values: dict[str, object]) -> list[str]:
    lines = []
    for key, value in values.items():
        name = f"{prefix}{key.rstrip('_')}"
        lines += _flat(f"{name}.", value) if isinstance(value, dict) else [f"{name} = {value}"]
    return lines
