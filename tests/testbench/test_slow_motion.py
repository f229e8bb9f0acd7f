"""Teeth as a browser draws them, read back: in the report they stand where the rig had them, and on
the page to play with the controller meets the gap."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from browser import browse

from meshpoint.bench.simulate import Setup, simulate
from meshpoint.cli.main import main
from meshpoint.controller.settings.settings import ControllerSettings
from meshpoint.dbc.frame import Frame
from meshpoint.dbc.link import Receiver
from meshpoint.dbc.messages import ReferencePhase
from meshpoint.dbc.node import Node
from meshpoint.gearbox import load_sheet
from meshpoint.gearbox.gears import DRIVE_GEARS
from meshpoint.report.collect import ReportCollector
from meshpoint.report.run import Report, ReportRun
from meshpoint.report.write import report_provenance, write_report
from meshpoint.results.rows import is_aimed
from meshpoint.rig_sim.settings import Preset
from meshpoint.units import DEG

SHEET = load_sheet("thesis")
PITCH_DEG = 7.5
READ_BACK = """<script>
addEventListener("load", () => {
  const slider = document.getElementById("motion-time");
  const tooth = document.getElementById("aimed-tooth");
  const degrees = () => {
    const screen = tooth.ownerSVGElement.getScreenCTM();
    const box = tooth.getBoundingClientRect();
    const x = ((box.left + box.right) / 2 - screen.e) / screen.a;
    return ((x - 450) / 900) * 3 * PITCH;
  };
  const read = [[Number.NaN, degrees()]];
  for (const at of TIMES) {
    slider.value = at;
    slider.dispatchEvent(new Event("input"));
    read.push([Number(slider.value), degrees()]);
  }
  const reported = document.createElement("pre");
  reported.id = "read-back";
  reported.textContent = JSON.stringify(read);
  document.body.append(reported);
});
</script>"""
FRAMES = """<script>
// A browser without a screen draws no frames while its time is only pretended.
window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 16);
</script>"""
FIRE_OFTEN = """<script>
addEventListener("load", () => {
  document.getElementById("scatter").value = 0;
  document.getElementById("slower").value = 1;
  document.getElementById("scatter").dispatchEvent(new Event("input"));
  setInterval(() => document.getElementById("controller").click(), 50);
});
</script>"""


@pytest.mark.device
@pytest.mark.long
def test_what_is_drawn_equals_the_truth_within_a_hundredth_of_a_degree(tmp_path: Path) -> None:
    setup = Setup(SHEET, ControllerSettings(), Preset.THESIS, seed=4, shifts=4)
    collector, receiver = ReportCollector(SHEET), Receiver(*Node)
    truth: dict[int, ReferencePhase] = {}

    def hear(_time_us: int, frame: Frame) -> None:
        collector.receive(frame)
        message = receiver.receive(frame).message
        if isinstance(message, ReferencePhase):
            truth[message.sample_time_us] = message

    rows = simulate(setup, hear).rows
    run = ReportRun("target_phase", collector.finish())
    page, row = tmp_path / "report.html", next(filter(is_aimed, rows))  # the page opens with it
    write_report(page, Report("r", "s", SHEET, [run], report_provenance(SHEET)))
    gear = DRIVE_GEARS[row.to].main.name.lower()
    expected = {
        (at_us - row.request_us) / 1000: getattr(message, f"phase_{gear}_rad") / DEG
        for at_us, message in truth.items()
        if row.contact_us is not None and at_us - row.contact_us > -100_000 and at_us < row.end_us
    }
    assert len(expected) > 10
    script = READ_BACK.replace("TIMES", json.dumps(list(expected)))
    page.write_text(page.read_text() + script.replace("PITCH", str(PITCH_DEG)))
    shown, console = browse(page.as_uri(), tmp_path)
    assert console == []
    (reported,) = re.findall(r'<pre id="read-back">(.*?)</pre>', shown)
    (_, at_contact), *drawn = json.loads(reported)
    assert row.phase_error_deg is not None
    assert at_contact == pytest.approx(row.phase_error_deg, abs=0.01)
    for (time_ms, drawn_deg), (asked_ms, true_deg) in zip(drawn, expected.items(), strict=True):
        assert time_ms == pytest.approx(asked_ms)
        off = (drawn_deg - true_deg + PITCH_DEG / 2) % PITCH_DEG - PITCH_DEG / 2
        assert abs(off) < 0.01, (time_ms, drawn_deg, true_deg)


@pytest.mark.device
def test_without_scatter_the_controller_of_the_page_always_meets_the_gap(tmp_path: Path) -> None:
    page = tmp_path / "play.html"
    assert main(["play", "--out", str(page), "--gearbox", "thesis"]) == 0
    page.write_text(page.read_text().replace("<body>", f"<body>{FRAMES}") + FIRE_OFTEN)
    shown, console = browse(page.as_uri(), tmp_path, 20_000)
    assert console == []
    cells = re.search(r"<tr><td>controller</td>(.*?)</tr>", shown)
    assert cells is not None
    fired, gap = map(int, re.findall(r">(\d+)<", cells[1])[:2])
    assert fired >= 5
    assert gap == fired
    assert "In the gap" in shown


def test_a_page_into_a_missing_folder_makes_it_and_a_folder_in_its_place_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["play", "--out", str(tmp_path / "new" / "play.html")]) == 0
    assert (tmp_path / "new" / "play.html").stat().st_size > 1000
    assert main(["play", "--out", str(tmp_path)]) == 2
    assert str(tmp_path) in capsys.readouterr().err
