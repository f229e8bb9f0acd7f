"""The data sheet: exact teeth, SI values, and nothing accepted that cannot be a gearbox."""

from __future__ import annotations

import dataclasses
import json
import math
import tomllib
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshpoint.gearbox import GearboxSheet, MainGear, Range, SheetError, Split, load_sheet
from meshpoint.gearbox.gears import MAIN_GEARS, SPLIT_GEARS, Sleeve, SplitGear
from meshpoint.gearbox.keys import groups_of, to_toml
from meshpoint.gearbox.sheet import SHEET_NAMES, sheet_from_canonical
from meshpoint.gearbox.tables import read_group
from meshpoint.gearbox.wheels import Mesh

TEXT = (Path(__file__).parents[2] / "meshpoint" / "gearbox" / "sheets" / "thesis.toml").read_text()


def load_text(folder: Path, text: str) -> GearboxSheet:
    path = folder / "truck.toml"
    path.write_text(text, encoding="utf-8")
    return load_sheet(path)


def test_tooth_counts_are_exact() -> None:
    """As the file has them; a rounded ratio would drift a tooth in minutes."""
    sheet = load_sheet("thesis")
    exact = {gear: sheet.main_mesh(gear).exact for gear in MAIN_GEARS}
    assert exact == {
        MainGear.CRAWL: Fraction(14, 51),
        MainGear.FIRST: Fraction(23, 50),
        MainGear.SECOND: Fraction(31, 40),
        MainGear.THIRD: Fraction(40, 31),
    }
    assert sheet.split_mesh(Split.LOW).exact == Fraction(30, 41)
    assert sheet.split_mesh(Split.HIGH).exact == Fraction(34, 36)
    assert sheet.range_mesh(Range.LOW).exact == Fraction(20, 94)
    assert sheet.range_mesh(Range.HIGH).exact == 1


@settings(deadline=None)
@given(driving=st.integers(8, 200), driven=st.integers(8, 200))
def test_a_ratio_is_the_nearest_float_of_its_teeth(driving: int, driven: int) -> None:
    mesh = Mesh(driving, driven)
    assert mesh.ratio == float(mesh.exact)
    assert mesh.ratio * driven == pytest.approx(driving, rel=1e-15)


def test_attributes_are_si() -> None:
    sheet = load_sheet("thesis")
    assert sheet.dog.pitch_rad == pytest.approx(math.radians(7.5))
    assert sheet.dog.backlash_rad == pytest.approx(math.radians(1.5))
    assert sheet.brake.time_constant_s == pytest.approx(0.060)
    assert sheet.air.supply_gauge_pa == pytest.approx(8e5)
    assert sheet.sleeve.delay_s == pytest.approx(0.045)
    assert sheet.sleeve.stroke_m == pytest.approx(0.012)
    assert sheet.limits.input_max_rad_s == pytest.approx(2600 * math.pi / 30)
    assert sheet.wheels.layshaft.duty_share == pytest.approx(0.5)
    assert sheet.brake.least_valve_delay_s == pytest.approx(0.0102)
    assert sheet.brake.greatest_valve_delay_s == pytest.approx(0.0138)
    assert sheet.brake_nm_per_pa * sheet.air.supply_gauge_pa == pytest.approx(100.0)


def test_the_inertia_at_the_layshaft_keeps_the_kinetic_energy() -> None:
    """4.13: both shafts turning together have the energy of one inertia at the layshaft."""
    sheet = load_sheet("thesis")
    for split in Split:
        layshaft = 150.0
        input_ = layshaft / sheet.split_mesh(split).ratio
        energy = 0.5 * (0.20 * layshaft**2 + 0.14 * input_**2)
        assert 0.5 * sheet.inertia_kgm2(split) * layshaft**2 == pytest.approx(energy)


def test_the_canonical_form_gives_the_sheet_back() -> None:
    sheet = load_sheet("thesis")
    again = sheet_from_canonical(json.loads(sheet.canonical()))
    assert again == sheet
    assert again.sha256 == sheet.sha256


def test_a_wheel_may_have_missing_teeth(tmp_path: Path) -> None:
    text = TEXT.replace("[wheels.main]\n", "[wheels.main]\nmissing = [43, 44]\n")
    sheet = load_text(tmp_path, text)
    assert sheet.wheels.main.missing == (43, 44)
    assert sheet.wheels.layshaft.missing == ()
    assert sheet_from_canonical(json.loads(sheet.canonical())) == sheet


@pytest.mark.parametrize(
    ("missing", "named"),
    [
        ("[44, 43]", "rising"),
        ("[45]", "44"),
        ("[-1]", "from 0"),
        ("[1.5]", "whole"),
        ("[14, 29, 44]", "repeats"),
        ("[0, 6, 12, 18, 24, 30, 36, 42]", "6 teeth"),
        ("7", "list"),
    ],
)
def test_missing_teeth_that_tell_nothing_are_refused(
    tmp_path: Path, missing: str, named: str
) -> None:
    text = TEXT.replace("[wheels.main]\n", f"[wheels.main]\nmissing = {missing}\n")
    with pytest.raises(SheetError, match=named):
        load_text(tmp_path, text)


def test_the_hash_is_of_the_values_and_not_of_the_file(tmp_path: Path) -> None:
    sheet = load_sheet("thesis")
    commented = TEXT.replace("[dog]", "# the dog teeth\n\n[dog]   # here")
    assert load_text(tmp_path, commented).sha256 == sheet.sha256
    changed = load_text(tmp_path, TEXT.replace("radius_mm = 75.0", "radius_mm = 75.1"))
    assert changed.sha256 != sheet.sha256


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(GearboxSheet)])
def test_every_table_is_in_the_hash(field: str) -> None:
    values = json.loads(load_sheet("thesis").canonical())
    assert field in values


def line(old: str, new: str) -> Callable[[str], str]:
    assert old in TEXT, old
    return lambda text: text.replace(old, new, 1)


@pytest.mark.parametrize(
    ("spoil", "named"),
    [
        (line("teeth_driving = 23", "teeth_driving = 23.5"), ("main", "first", "teeth_driving")),
        (line("teeth_driving = 23", "teeth_driving = 7"), ("teeth_driving", "7", "8", "200")),
        (line("teeth_driving = 23", "teeth_driving = 201"), ("teeth_driving", "201", "200")),
        (line("teeth_driving = 23", "teeth_driving = true"), ("teeth_driving = true,",)),
        (line("teeth_driving = 23", "ratio = 0.46"), ("ratio", "teeth_driving")),
        (line("friction_nms = 0.10", "friction_nms = nan"), ("friction_nms", "nan")),
        (line("friction_nms = 0.10", "friction_nms = -inf"), ("friction_nms", "inf")),
        (line("friction_nms = 0.10", "friction_nms = -0.1"), ("friction_nms", "-0.1", "0")),
        (line("friction_nms = 0.10", 'friction_nms = "0.1"'), ("friction_nms", "0.1")),
        (line("friction_nms = 0.10", ""), ("friction_nms", "missing")),
        (line("[clutch]", "[cluch]"), ("cluch", "clutch")),
        (line("to_contact_mm = 5.0\nstroke_mm = 12.0", "to_contact_mm = 8.0\nstroke_mm = 8.0"),
         ("to_contact_mm = 8", "stroke_mm = 8")),
        (line("valve_delay_ms = 12.0\nto", "valve_delay_ms = 40.0\nto"),
         ("delay_ms = 45", "valve_delay_ms + delay_limit_ms = 4")),
        (line("teeth_driving = 14", "teeth_driving = 24"), ("main", "24/", "crawl", "first, 23/")),
        (line("teeth_driving = 34", "teeth_driving = 25"), ("splitter", "in low", "in high, 25/")),
        (line("teeth_driven = 94", "teeth_driven = 20"), ("range", "/20", "in low", "in high")),
        (line('name = "thesis"', "name = 3"), ("name", "3")),
    ],
)  # fmt: skip
def test_what_cannot_be_a_gearbox_is_refused_by_file_and_key(
    tmp_path: Path, spoil: Callable[[str], str], named: tuple[str, ...]
) -> None:
    with pytest.raises(SheetError) as refusal:
        load_text(tmp_path, spoil(TEXT))
    for word in ("truck.toml", *named):
        assert word in str(refusal.value)


def test_a_sheet_that_is_not_there_is_refused_with_the_names_there_are(tmp_path: Path) -> None:
    with pytest.raises(SheetError, match=r"lorry.*thesis"):
        load_sheet("lorry")
    with pytest.raises(SheetError, match="truck"):
        load_sheet(tmp_path / "truck.toml")


def test_a_splitter_has_cones_or_dog_teeth(tmp_path: Path) -> None:
    """Its teeth are those of the main box, unless it says otherwise; its gears are on the input
    shaft, driven by the layshaft."""
    cones, dog = load_sheet("truck12"), load_sheet("truck12-dog")
    assert (cones.has_dog_splitter, dog.has_dog_splitter) == (False, True)
    assert cones.dog_gears == MAIN_GEARS
    assert dog.dog_gears == (*MAIN_GEARS, *SPLIT_GEARS)
    assert dog.dog_mesh(SplitGear.LOW_SPLIT).exact == 1 / dog.split_mesh(Split.LOW).exact
    assert dog.teeth_of(Sleeve.SPLITTER) == dog.dog
    own = 'based_on = "truck12-dog"\n[splitter.dog]\nteeth = 36\nradius_mm = 60\n'
    sheet = load_text(tmp_path, own + "backlash_percent_of_pitch = 25\n")
    assert sheet.teeth_of(Sleeve.SPLITTER).teeth == 36
    assert sheet.teeth_of(Sleeve.FIRST_SECOND).teeth == 48
    for one in (cones, dog, sheet):
        assert sheet_from_canonical(json.loads(one.canonical())) == one


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('engagement = "cogs"', "splitter: engagement = 'cogs', allowed is one of cones, dog"),
        ("dog = 3", "splitter: dog: found 3, allowed is a table"),
        ("[splitter.dog]\nteeth = 7", "teeth = 7, allowed is a whole number from 8 to 96"),
        (
            "[splitter.dog]\nteeth = 48\nradius_mm = 75\nbacklash_percent_of_pitch = 20",
            'engagement = "cones" with a table dog, allowed is "dog"',
        ),
    ],
)
def test_what_a_splitter_cannot_be(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(SheetError) as found:
        load_text(tmp_path, f'based_on = "truck12"\n[splitter]\n{text}\n')
    assert str(found.value).startswith("truck.toml: splitter")
    assert said in str(found.value)


def test_a_sheet_with_cones_has_the_hash_that_it_always_had() -> None:
    """So that a run of it has the header, and the frames, of before there was a choice."""
    assert load_sheet("truck12").sha256.startswith("aa110d2669f50e86")
    assert load_sheet("thesis").sha256.startswith("0a294dad3c2cdb52")


@pytest.mark.parametrize("name", SHEET_NAMES)
def test_a_sheet_written_out_reads_back_as_itself(name: str) -> None:
    """Also the table that a sheet leaves out: the splitter's dog teeth, where it has cones."""
    sheet = load_sheet(name)
    text = to_toml(groups_of(GearboxSheet, sheet), "")
    assert read_group(GearboxSheet, tomllib.loads(text), name) == sheet
