"""The HTML report against the files that it is made of, and in a browser."""

import json
import platform
import re
import shlex
import shutil
import subprocess
import threading
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from html.parser import HTMLParser
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from nnql_bullet.cli import main
from nnql_bullet.config import read_toml
from nnql_bullet.geometry import OrientedBox
from nnql_bullet.recording import load_recording
from nnql_bullet.reports import player, plots
from nnql_bullet.rollout import EpisodeSummary
from nnql_bullet.training.loop import TrainingEpisode
from nnql_bullet.worlds.spec import Patrol

RunCli = Callable[..., tuple[int, str, str]]
Snapshot = Callable[[Path], dict[str, bytes]]

CHROMIUM = shutil.which("chromium")
NEEDS_CHROMIUM = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium (Debian: chromium)")
BROWSERS_OWN = ("google.com", "googleapis.com", "gvt1.com")
"""Hosts that the browser asks for itself, whatever it shows."""


@dataclass
class Element:
    tag: str
    attributes: dict[str, str]
    text: str = ""


@dataclass
class Page(HTMLParser):
    """A page's elements with all the text in them, in their order."""

    source: str
    elements: list[Element] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()
        self._open: list[Element] = []
        self.feed(self.source)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        element = Element(tag, {name: value or "" for name, value in attrs})
        self.elements.append(element)
        if tag not in ("img", "input", "meta"):
            self._open.append(element)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop().tag == tag

    def handle_data(self, data: str) -> None:
        for element in self._open:
            element.text += data

    def all(self, tag: str) -> list[Element]:
        return [element for element in self.elements if element.tag == tag]

    def section(self, name: str) -> str:
        return next(e.text for e in self.all("section") if e.attributes["id"] == name)

    @property
    def cells(self) -> list[str]:
        return [e.text for e in self.elements if e.tag in ("th", "td")]

    @property
    def commands(self) -> list[str]:
        return [e.text for e in self.all("code") if e.text.startswith("nnql-bullet ")]

    @property
    def pictures(self) -> list[bytes]:
        uris = [image.attributes["src"] for image in self.all("img")]
        return [b64decode(uri.removeprefix("data:image/png;base64,"), validate=True) for uri in uris]


def call(*arguments: object) -> None:
    assert main([str(argument) for argument in arguments]) == 0


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory, small_config: Path) -> Iterator[Path]:
    """A working folder with two runs of one recipe, evaluated beside a rule, and the gap of the first. Read only.

    `report.html` shows their failures sorted, `unsorted.html` is from before that.

    Their vehicles have 60 steps, so that no world of 100 m is crossed: there are failures.
    """
    folder = tmp_path_factory.mktemp("work")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for seed in (0, 1):
            training = ("--sim", "kinematic", "--episodes", 8, "--config", small_config, "--seed", seed)
            call("train", *training, "--out", f"runs/tiny-{seed}")
        driving = ("--worlds", 2, "--sim", "kinematic", "--executor", "inline")
        call("evaluate", "runs/tiny-0", "runs/tiny-1", "straight", "--cover", "5,10", *driving)
        call("gap", "runs/tiny-0", "--worlds", 2, "--physics", "fast", "--no-faults", "--workers", 1)
        call("report", "runs/tiny-0", "runs/tiny-1", "--out", "runs/unsorted.html")
        call("failures", "--workers", 1)
        call("report", "runs/tiny-0", "runs/tiny-1")
        yield folder


@pytest.fixture
def here(work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of that folder to change, as the working folder."""
    folder = tmp_path / "here"
    shutil.copytree(work, folder)
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture(scope="module")
def page(work: Path) -> Page:
    return Page((work / "runs" / "report.html").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def unsorted(work: Path) -> Page:
    return Page((work / "runs" / "unsorted.html").read_text(encoding="utf-8"))


def table_cells(markdown: str) -> list[str]:
    rows = [line for line in markdown.splitlines() if line.startswith("| ") and not line.startswith("| ---")]
    return [cell.strip().replace("`", "") for row in rows for cell in row.strip("|").split("|")]


class TestPage:
    def test_it_holds_all_that_it_shows(self, page: Page) -> None:
        links = [e.attributes[name] for e in page.elements for name in ("href", "src") if name in e.attributes]
        assert all(link.startswith(("#", "data:image/png;base64,")) for link in links)
        assert not {"link", "iframe", "object"} & {element.tag for element in page.elements}
        assert not re.search(r"url\(|@import|https?://", page.source)
        assert "default-src 'none'" in page.source

    def test_the_only_script_that_may_run_is_the_player(self, page: Page, unsorted: Page) -> None:
        *data, script = page.all("script")
        assert {element.attributes.get("type") for element in data} == {"application/json"}
        assert script.attributes == {}
        assert script.text == (resources.files("nnql_bullet.reports") / "player.js").read_text(encoding="utf-8")
        digest = b64encode(sha256(script.text.encode()).digest()).decode()
        allowed = f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
        policies = [e.attributes.get("content") for e in page.all("meta") if "http-equiv" in e.attributes]
        assert policies == [allowed]
        assert not re.search(r"\bfetch|XMLHttp|import|eval|innerHTML", script.text)
        assert not unsorted.all("script")
        assert "script-src" not in unsorted.source

    def test_the_contents_lead_to_its_sections(self, page: Page) -> None:
        targets = [link.attributes["href"] for link in page.all("a")]
        assert targets == [f"#{section.attributes['id']}" for section in page.all("section")]

    def test_every_table_of_the_results_is_there(self, page: Page, work: Path) -> None:
        text = (work / "runs/evaluate/evaluation.md").read_text() + (work / "runs/gap/gap.md").read_text()
        cells = table_cells(text)
        assert len(cells) > 100
        assert not set(cells) - set(page.cells)

    def test_every_picture_of_runs_and_results_is_there_with_a_text_instead(self, page: Page, work: Path) -> None:
        shown = ("evaluate/outcomes.png", "evaluate/cover.png", "gap/gap.png")
        shown += ("tiny-0/learning_curve.png", "tiny-1/learning_curve.png")
        assert all((work / "runs" / name).read_bytes() in page.pictures for name in shown)
        assert all(image.attributes["alt"] for image in page.all("img"))
        for image, data in zip(page.all("img"), page.pictures, strict=True):
            height, width = imageio.imread(data).shape[:2]
            # 150 dots to the inch, of which a page has 96 units
            size = (int(image.attributes["width"]), int(image.attributes["height"]))
            assert size == pytest.approx((width * 96 / 150, height * 96 / 150), abs=0.51)

    def test_what_departs_from_the_preset_is_marked(self, page: Page, work: Path, small_world: Path) -> None:
        rows = [row for row in page.all("tr") if re.match(r"[a-z_]+(\.[a-z_]+)*\b", row.text)]
        assert rows
        marked = {e.text for e in page.all("td") if e.attributes.get("class") == "value departs"}
        assert marked == {"≠ 0, 1", "≠ 8", f"≠ {small_world}", "≠ kinematic", "≠ 60"}

    def test_every_key_of_the_configuration_is_there(self, page: Page, work: Path) -> None:
        values = read_toml(work / "runs/tiny-0/config.toml")
        keys = [key for key, value in values.items() if not isinstance(value, dict)]
        keys += [f"{table}.{key}" for table in ("drive", "task", "agent") for key in values[table]]
        assert len(keys) > 25
        assert not set(keys) - {cell.strip() for cell in page.cells}

    def test_failures_of_the_runs_alone_are_shown_by_group(self, page: Page, work: Path) -> None:
        groups = json.loads((work / "runs/evaluate/failures/failures.json").read_text())["groups"]
        commands = [command for command in page.commands if command.startswith("nnql-bullet drive")]
        shown = []
        for group in groups:
            theirs = [one["replay"] for one in group["failures"] if one["policy"] != "straight"]
            its = [command for command in commands if command in theirs]
            assert len(its) == min(len(theirs), 4)
            assert (f"{group['name'].capitalize()}: {len(theirs)}" in page.section("failures")) == bool(theirs)
            shown += its
        assert len(shown) >= 2
        assert commands == shown
        sheets = [image for image in page.all("img") if ": paths of" in image.attributes["alt"]]
        assert len(sheets) == sum(any(one["policy"] != "straight" for one in group["failures"]) for group in groups)
        assert len(page.all("figure")) >= len(shown) + len(sheets)

    def test_a_player_is_told_what_was_recorded(self, page: Page, work: Path) -> None:
        groups = json.loads((work / "runs/evaluate/failures/failures.json").read_text())["groups"]
        recordings = {one["title"]: one["recording"] for group in groups for one in group["failures"]}
        told = [json.loads(e.text) for e in page.all("script") if e.attributes]
        assert len(told) >= 2
        for drive in told:
            its = load_recording(work / "runs/evaluate" / recordings[drive["title"]])
            x, y, times = (np.cumsum(drive[name]) / 100 for name in ("x", "y", "times"))
            assert times == pytest.approx(its.state_time, abs=0.006)
            at = np.rint(its.state_time[:-1] * drive["rate"]).astype(int)  # decisions fall on poses, but for the last
            assert np.column_stack([x, y])[at] == pytest.approx(its.state_pose[:-1, :2], abs=0.006)
            assert (x[-1], y[-1]) == pytest.approx(tuple(its.state_pose[-1, :2]), abs=0.006)
            yaw = np.cumsum(drive["yaw"]) / 100
            assert np.cos(yaw[at] - its.state_pose[:-1, 2]) == pytest.approx(1.0, abs=1e-4)
            assert np.reshape(drive["readings"], (-1, 8)) / 10 == pytest.approx(its.readings, abs=0.051)
            assert drive["states"] == "".join(label[0] for label in its.state_property)
            assert len(drive["boxes"]) == len(its.obstacles)
            assert drive["ending"] == its.about["ending"]

    def test_without_groups_the_first_failures_are_shown_and_how_to_sort_them(self, unsorted: Page, work: Path) -> None:
        failures = json.loads((work / "runs/evaluate/results.json").read_text())["failures"]
        theirs = [one["replay"] for one in failures if one["policy"] != "straight"]
        rules = [one["replay"] for one in failures if one["policy"] == "straight"]
        assert len(theirs) >= 2
        assert [command for command in unsorted.commands if command in theirs] == theirs
        assert not set(rules) & set(unsorted.commands)
        assert sum(image.attributes["alt"].startswith("Path of") for image in unsorted.all("img")) == len(theirs)
        assert "nnql-bullet failures runs/evaluate" in unsorted.commands

    def test_it_names_neither_the_machine_nor_a_path_of_it(self, page: Page) -> None:
        assert platform.node() not in page.section("versions")
        assert "/" not in page.section("versions")
        assert platform.python_version() in page.section("versions")

    def test_the_same_inputs_give_the_same_bytes(self, work: Path, here: Path, run_cli: RunCli) -> None:
        code, out, err = run_cli("report", "runs/tiny-0", "runs/tiny-1", "--out", "again.html")
        assert (code, out, err) == (0, "report: again.html\n", "")
        first, again = (work / "runs/report.html").read_text(), Path("again.html").read_text()
        assert again.replace(" --out again.html", "") == first

    def test_what_results_say_is_text_and_not_html(self, here: Path, run_cli: RunCli) -> None:
        odd = "runs/<b>x & y"
        shutil.move("runs/tiny-0", odd)
        results = Path("runs/evaluate/results.json")
        odd_text = "<script>alert(1)</script> [out](https://example.org) <https://example.org>"
        values = json.loads(results.read_text())
        values["report"]["sections"][0]["blocks"].append(odd_text)
        results.write_text(json.dumps(values))
        assert run_cli("report", odd, "--out", "odd.html")[0] == 0
        page = Page(Path("odd.html").read_text())
        assert page.all("h1")[0].text == "<b>x & y"
        assert odd_text in page.section("evaluation")
        assert all(script.attributes.get("type") for script in page.all("script")[:-1])
        assert all(link.attributes["href"].startswith("#") for link in page.all("a"))


class TestCommands:
    def test_they_regenerate_everything(self, page: Page, work: Path, here: Path, run_cli: RunCli) -> None:
        shutil.rmtree("runs")
        for file in (pre for pre in page.all("pre") if "title" in pre.attributes):
            Path(file.attributes["title"]).write_text(file.text)
        quicker = {"evaluate": ("--executor", "inline"), "gap": ("--workers", 1), "failures": ("--workers", 1)}
        # which change no result
        for command in page.commands[-6:]:
            _, verb, *arguments = shlex.split(command)
            assert run_cli(verb, *arguments, *quicker.get(verb, ()))[0] == 0
        made = ("tiny-1/episodes.csv", "evaluate/results.json", "evaluate/failures/failures.json", "gap/gap.json")
        for name in (*made, "report.html"):
            assert Path("runs", name).read_bytes() == (work / "runs" / name).read_bytes()

    def test_a_preset_is_named_where_it_says_it_all(self, here: Path, run_cli: RunCli) -> None:
        training = ("--config", "literal", "--episodes", 2, "--sim", "kinematic", "--seed", 3)
        assert run_cli("train", *training, "--out", "runs/l 3")[0] == 0
        assert run_cli("report", "runs/l 3")[0] == 0
        expected = "nnql-bullet train --config literal --seed 3 --episodes 2 --sim kinematic --out 'runs/l 3'"
        assert expected in Page(Path("runs/l 3/report.html").read_text()).commands


class TestWhatIsMissing:
    def test_is_said_with_the_command_that_makes_it(self, here: Path, run_cli: RunCli) -> None:
        for name in ("evaluate", "gap"):
            shutil.rmtree(f"runs/{name}")
        Path("runs/tiny-0/learning_curve.png").unlink()
        assert run_cli("report", "runs/tiny-0")[0] == 0
        page = Page(Path("runs/tiny-0/report.html").read_text())
        needed = {"evaluate": "evaluation", "gap": "gap", "train --resume": "learning"}
        for command, section in needed.items():
            assert f"nnql-bullet {command} runs/tiny-0" in page.section(section)

    def test_a_run_that_has_not_come_to_its_end(self, here: Path, run_cli: RunCli) -> None:
        config = Path("runs/tiny-0/config.toml")
        config.write_text(config.read_text().replace("episodes = 8", "episodes = 30"))
        assert run_cli("report", "runs/tiny-0")[0] == 0
        page = Page(Path("runs/tiny-0/report.html").read_text())
        assert "stopped after 8 of 30 episodes" in page.section("runs")
        assert "nnql-bullet train --resume runs/tiny-0" in page.section("runs")

    def test_a_run_that_was_left_out(self, here: Path, run_cli: RunCli, page: Page) -> None:
        assert "Not in it: tiny-1" in page.section("gap")
        assert "nnql-bullet gap runs/tiny-0 runs/tiny-1" in page.section("gap")
        assert "Not in it" not in page.section("evaluation")

    def test_results_of_a_run_before_it_went_on_are_not_its(self, here: Path, run_cli: RunCli) -> None:
        assert run_cli("train", "--resume", "runs/tiny-0", "--episodes", 9)[0] == 0
        assert run_cli("report", "runs/tiny-0")[0] == 0
        page = Page(Path("runs/tiny-0/report.html").read_text())
        assert "as they are now" in page.section("evaluation")
        assert "as they are now" in page.section("gap")


class TestRefusals:
    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (("runs/nowhere",), ["runs/nowhere", "holds no run"]),
            (("straight",), ["straight", "holds no run"]),
            (("runs/tiny-0", "runs/tiny-0"), ["given twice"]),
            (("runs/tiny-0", "--evaluation", "runs"), ["runs: holds no results of 'evaluate'", "nnql-bullet evaluate"]),
            (("runs/tiny-0", "--gap", "runs/evaluate"), ["runs/evaluate: holds no results of 'gap'"]),
            (("runs/tiny-1", "--gap", "runs/gap"), ["runs/gap: holds no results of 'gap' with one of these runs"]),
            (("runs/tiny-0", "--out", "runs"), ["is a folder"]),
        ],
    )
    def test_one_line_and_nothing_written(
        self, here: Path, run_cli: RunCli, snapshot: Snapshot, arguments: tuple[str, ...], words: list[str]
    ) -> None:
        before = snapshot(here)
        code, out, err = run_cli("report", *arguments)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert [word for word in words if word not in err] == []
        assert snapshot(here) == before

    @pytest.mark.parametrize(
        ("file", "data", "word"),
        [
            ("evaluate/results.json", b"{", "evaluate"),
            ("evaluate/results.json", b"[]", "evaluate"),
            ("gap/gap.png", None, "gap.png"),
            ("evaluate/outcomes.png", b"GIF89a", "outcomes.png"),
            ("evaluate/failures/failures.json", b"{}", "evaluate"),
            ("tiny-0/learning_curve.png", b"", "learning_curve.png"),
        ],
    )
    def test_damage_is_named(self, here: Path, run_cli: RunCli, file: str, data: bytes | None, word: str) -> None:
        path = Path("runs", file)
        if data is None:
            path.unlink()
        else:
            path.write_bytes(data)
        before = Path("runs/report.html").read_bytes()
        code, out, err = run_cli("report", "runs/tiny-0", "runs/tiny-1")
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert word in err
        assert Path("runs/report.html").read_bytes() == before


def episodes(goals: list[bool]) -> list[TrainingEpisode]:
    ends = ["goal" if goal else "collision" for goal in goals]
    summaries = [EpisodeSummary(0, end, 1, 0.5, 1.0, 1.0, 1.0, 0.0, 0.0, 0, 0.0, {}) for end in ends]
    return [TrainingEpisode(number, summary, {}) for number, summary in enumerate(summaries)]


def test_the_mean_over_seeds_is_that_of_the_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(FigureCanvasAgg, "print_png", lambda canvas, path, **_: drawn.append(canvas.figure))
    generator = np.random.default_rng(0)
    goals = {name: (generator.random(length) < 0.5).tolist() for name, length in (("a", 40), ("b", 60), ("c", 50))}
    runs = {name: episodes(its) for name, its in goals.items()}
    plots.draw_success(
        {"two": {"a": runs["a"], "b": runs["b"]}, "c": {"c": runs["c"]}}, tmp_path / "success.png", window=10
    )
    (axes,) = drawn[0].axes
    a, b, mean, c = ([float(value) for value in line.get_ydata()] for line in axes.lines)
    for curve, its in ((a, "a"), (b, "b"), (c, "c")):
        assert curve[9:] == pytest.approx(100 * np.convolve(goals[its], np.full(10, 0.1), "valid"))
    assert len(mean) == 40
    assert mean[9:] == pytest.approx((np.array(a[9:]) + np.array(b[9:40])) / 2)
    assert drawn[0].legends[0].get_texts()[0].get_text() == "two: mean of 2"


class Dead(BaseHTTPRequestHandler):
    """A network that answers nothing and notes who was asked for."""

    asked: list[str]

    def answer(self) -> None:
        self.asked.append(re.sub(r"^\w+://", "", self.path).split("/")[0].split(":")[0])
        self.send_error(404)

    do_GET = do_POST = do_HEAD = do_CONNECT = answer

    def log_message(self, *arguments: object) -> None:
        """Says nothing."""


@pytest.fixture
def browse(tmp_path: Path) -> Iterator[Callable[[str], tuple[Page, list[str]]]]:
    """Opens a page from disk on a phone's width: what the browser makes of it, and what hosts it asked for."""
    asked: list[str] = []
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("Noted", (Dead,), {"asked": asked}))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    quiet = ("--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync")

    def open_page(source: str) -> tuple[Page, list[str]]:
        asked.clear()
        (tmp_path / "page.html").write_text(source, encoding="utf-8")
        profile = tmp_path / "profile"
        shutil.rmtree(profile, ignore_errors=True)
        network = ("--disable-quic", f"--proxy-server=http://127.0.0.1:{server.server_port}")
        command = [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", *quiet, *network]
        command += [f"--user-data-dir={profile}", "--window-size=390,800", "--dump-dom"]
        done = subprocess.run(
            [*command, (tmp_path / "page.html").as_uri()], capture_output=True, text=True, timeout=120, check=True
        )
        return Page(done.stdout), [host for host in asked if not host.endswith(BROWSERS_OWN)]

    yield open_page
    server.shutdown()
    server.server_close()


@NEEDS_CHROMIUM
class TestInABrowser:
    LOOK = """<img id="broken" src="data:image/png;base64,AAAA" alt="">
    <script>addEventListener("load", () => {
      for (const image of document.images) image.alt = image.naturalWidth + "x" + image.naturalHeight;
      const whole = document.documentElement;
      whole.lang = whole.scrollWidth - whole.clientWidth;
    });</script>"""

    def test_pictures_are_decoded_tables_are_there_and_a_phone_is_wide_enough(
        self, page: Page, browse: Callable[[str], tuple[Page, list[str]]]
    ) -> None:
        looked_at = page.source.replace("default-src 'none'", "default-src 'none'; script-src 'unsafe-inline'")
        shown, _ = browse(looked_at.replace("</body>", self.LOOK + "</body>"))
        assert shown.cells == page.cells
        *sizes, broken = (image.attributes["alt"] for image in shown.all("img"))
        expected = [imageio.imread(data).shape[1::-1] for data in page.pictures]
        assert sizes == [f"{width}x{height}" for width, height in expected]
        assert broken == "0x0"
        assert shown.all("html")[0].attributes["lang"] == "0"

    MOVE = """<script>
      const [first] = document.querySelectorAll("figure.player");
      const [whole, close] = first.querySelectorAll("canvas");
      const scrubber = first.querySelector("input");
      const vehicle = (canvas) => {  // where its colour is, as shares of the canvas
        const { data, width, height } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        let [count, x, y] = [0, 0, 0];
        for (let k = 0; k < width * height; k += 1) {
          const [red, green, blue] = data.slice(4 * k, 4 * k + 3);
          if (Math.abs(red - 250) + Math.abs(green - 176) + Math.abs(blue - 5) > 60) continue;
          [count, x, y] = [count + 1, x + ((k % width) + 0.5) / width, y + (Math.floor(k / width) + 0.5) / height];
        }
        return [count, x / count, y / count];
      };
      const seen = [0, 0.5, 1].map((share) => {
        scrubber.value = Math.round(share * scrubber.max);
        scrubber.dispatchEvent(new Event("input"));
        return [Number(scrubber.value), scrubber.getAttribute("aria-valuetext"), vehicle(whole), vehicle(close)];
      });
      const button = first.querySelector("button");
      const labels = [button.textContent];
      for (let k = 0; k < 2; k += 1) labels.push((button.click(), button.textContent));
      const places = [0, 3.5, 10, 19, 40, 61.2].map((time) => patrolAt(PATROL, time));
      document.body.dataset.seen = JSON.stringify([seen, labels, places]);
    </script>"""

    def test_the_player_draws_the_vehicle_where_it_was(
        self, page: Page, browse: Callable[[str], tuple[Page, list[str]]]
    ) -> None:
        looked_at = page.source.replace("default-src 'none'", "default-src 'none'; script-src 'unsafe-inline'")
        patrol = Patrol(OrientedBox(5.0, 7.0, 1.0, 0.5, 0.9), (17.0, 16.0), 0.8, 0.3)
        told = json.dumps(player._track(patrol, np.append(np.arange(0.0, 61.3, 0.1), 61.35)))
        shown, _ = browse(looked_at.replace("</body>", self.MOVE.replace("PATROL", told) + "</body>"))
        seen, labels, places = json.loads(shown.all("body")[0].attributes["data-seen"])
        assert labels == ["Play", "Pause", "Play"]
        boxes = [patrol.at(time) for time in (0.0, 3.5, 10.0, 19.0, 40.0, 61.2)]
        expected = np.array([(box.x, box.y, box.half_length, box.half_width, box.yaw) for box in boxes])
        assert np.array(places) == pytest.approx(expected, abs=2e-3)
        drive = json.loads(page.all("script")[0].text)
        x, y, yaw = (np.cumsum(drive[name]) / 100 for name in ("x", "y", "yaw"))
        ahead, side = drive["footprint"][0], max(drive["arena"]) + 4.0
        assert [i for i, *_ in seen] == [0, round((len(x) - 1) / 2), len(x) - 1]
        for i, said, whole, close in seen:
            time = min(i / drive["rate"], drive["end"])
            assert said.startswith(f"{time:.1f} s, ")
            assert said.endswith(drive["ending"]) == (i == len(x) - 1)
            middle = np.array([x[i] + ahead * np.cos(yaw[i]), y[i] + ahead * np.sin(yaw[i])])
            assert whole[0] > 0
            there = (whole[1] - 0.5) * side + drive["arena"][0] / 2, (0.5 - whole[2]) * side + drive["arena"][1] / 2
            assert there == pytest.approx(tuple(middle), abs=0.8)
            assert close[0] > 10
            around = (close[1] - 0.5) * 26.0, (0.5 - close[2]) * 26.0
            assert around == pytest.approx((ahead * np.cos(yaw[i]), ahead * np.sin(yaw[i])), abs=0.15)

    def test_the_pages_own_policy_lets_the_player_run_and_no_other_script(
        self, page: Page, browse: Callable[[str], tuple[Page, list[str]]]
    ) -> None:
        drives = [json.loads(e.text) for e in page.all("script") if e.attributes]
        shown, asked = browse(page.source)
        assert asked == []
        assert len(shown.all("canvas")) == 2 * len(drives)
        assert [e.text for e in shown.all("output")] == [f"{one['end']:.1f} s, {one['ending']}" for one in drives]
        assert [e.text for e in shown.all("button")] == ["Play"] * len(drives)
        assert all(e.attributes["aria-label"] for e in shown.elements if e.tag in ("canvas", "input"))
        other, _ = browse(page.source.replace('"use strict";', '"use strict"; '))
        assert not other.all("canvas")

    def test_nothing_is_asked_from_a_network(self, page: Page, browse: Callable[[str], tuple[Page, list[str]]]) -> None:
        careless = '<!DOCTYPE html><img src="http://pictures.example/one.png" alt="one">'
        assert browse(careless)[1] == ["pictures.example"]
        assert browse(page.source)[1] == []
        assert "google" not in page.source
