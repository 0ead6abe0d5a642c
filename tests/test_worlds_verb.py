"""`nnql-bullet worlds`, and maps of other programs in other verbs."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import nnql_bullet as nb
from nnql_bullet import assets
from nnql_bullet.recording import load_recording
from nnql_bullet.runs import load_run
from nnql_bullet.sources import changed_sources

Cli = Callable[..., tuple[int, str, str]]


@pytest.fixture
def hall(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The map of an empty hall of 12 m x 8 m, whose lower left corner is at (-6, -4), in the working folder."""
    monkeypatch.chdir(tmp_path)
    Image.fromarray(np.full((80, 120), 254, np.uint8)).save("hall.pgm")
    lines = ["image: hall.pgm", "resolution: 0.1", "origin: [-6, -4, 0]", "negate: 0"]
    Path("hall.yaml").write_text("\n".join([*lines, "occupied_thresh: 0.65", "free_thresh: 0.25", ""]))
    return "hall.yaml"


class TestList:
    def test_it_has_a_line_for_every_shipped_world(self, run_cli: Cli) -> None:
        code, out, err = run_cli("worlds", "list")
        names = {path.stem for path in assets.folder("worlds").glob("*.toml")}
        assert (code, err) == (0, "")
        assert {line.split()[0] for line in out.splitlines()[1:]} == names
        assert json.loads(run_cli("worlds", "list", "--json")[1]).keys() == names
        assert all(len(line.split()) > 3 for line in out.splitlines()[1:])


class TestShow:
    def test_text_json_and_picture_agree_with_the_world(self, run_cli: Cli, tmp_path: Path) -> None:
        code, out, _ = run_cli("worlds", "show", "rooms", "--seed", 1, "--json", "--out", tmp_path / "rooms.png")
        values, world = json.loads(out), nb.World.load("rooms").draw(1)
        assert code == 0
        assert (values["digest"], values["bottleneck"]) == (world.digest, world.bottleneck.width)
        assert values["path_length"] > 26.0  # 23.3 m as the crow flies, through walls
        with Image.open(tmp_path / "rooms.png") as picture:
            assert picture.width > picture.height > 500
        text = run_cli("worlds", "show", "rooms", "--seed", 1)[1]
        assert f"bottleneck {world.bottleneck.width:.2f} m" in text

    def test_what_does_not_pass_is_shown_all_the_same(self, run_cli: Cli, hall: str) -> None:
        world = nb.World.load(hall)
        narrow = nb.World.from_boxes(
            [(6, 1.75, 0.2, 3.5), (6, 6.05, 0.2, 3.9)],
            name="narrow",
            **{"width": 12, "depth": 8},
            start=(2, 4),
            target=(10, 4),
        )
        assert world.draw(0).bottleneck.width > 0.75
        view = nb.view_world(narrow)
        assert not view.values["passable"]
        assert "does not pass: it needs 0.75 m" in view.text()
        view.draw(Path("narrow.png"))
        assert Path("narrow.png").is_file()


class TestImportAndExport:
    def test_an_import_says_how_it_was_read_and_drives_as_the_map_does(self, run_cli: Cli, hall: str) -> None:
        ends = ("--start", "-4,-2,0.5", "--target", "4,2")
        code, out, err = run_cli("worlds", "import", hall, "--out", "mine.toml", *ends)
        assert (code, err) == (0, "")
        assert out.startswith("ROS map: world 'hall'")
        assert "unknown and count as solid" in out
        assert (
            nb.World.load("mine.toml").draw(0).digest
            == nb.World.load(hall).between((-4, -2, 0.5), (4, 2)).draw(0).digest
        )
        assert nb.World.load("mine.toml").origin == (-6.0, -4.0)

    def test_there_and_back_through_every_format(self, run_cli: Cli, hall: str) -> None:
        for name in ("a.world", "a.sdf", "a.yaml", "a.toml"):
            code, out, _ = run_cli("worlds", "export", hall, "--out", name, "--resolution", 0.1)
            assert code == 0
            assert name in out
            world = nb.World.load(name)
            assert (world.width, world.depth, world.origin) == (12.0, 8.0, (-6.0, -4.0))
        assert "--start=" in run_cli("worlds", "export", hall, "--out", "a.yaml")[1]

    def test_a_folder_is_imported_whole_and_what_is_refused_is_named(self, run_cli: Cli, hall: str) -> None:
        Path("maps").mkdir()
        nb.export_world("rooms", "maps/rooms.world")
        nb.export_world(hall, "maps/hall.yaml")
        Path("maps/bad.map").write_text("nothing")
        code, out, err = run_cli("worlds", "import", "maps", "--out", "mine")
        assert code == 1
        assert err.count("\n") == 1
        assert "bad.map" in err
        assert out.splitlines()[-1] == "2 of 3 worlds: mine"
        assert sorted(path.name for path in Path("mine").iterdir()) == ["hall.toml", "rooms.toml"]

    @pytest.mark.parametrize(
        ("arguments", "match"),
        [
            (("show",), "give a world"),
            (("show", "atlantis"), "no file 'atlantis'"),
            (("show", "rooms", "--out", "a.gif"), "end in .png"),
            (("show", "rooms", "--unknown", "free"), "is no map or world of another program"),
            (("show", "rooms", "--seed", "-1"), "seed must be from 0"),
            (("import", "hall.yaml"), "say where to write it with --out"),
            (("import", "hall.yaml", "--out", "a.yaml"), "end in .toml"),
            (("import", "rooms", "--out", "a.toml"), "no such file"),
            (("import", "hall.pgm", "--out", "a.toml"), "give the YAML file"),
            (("import", ".", "--out", "a.toml"), "to a folder"),
            (("import", "hall.yaml", "--out", "a.toml", "--start", "99,0"), "outside"),
            (("import", "hall.yaml", "--out", "a.toml", "--start", "0,0,90"), "radians"),
            (("export", "rooms", "--out", "a.obj"), "end in one of"),
            (("export", "rooms", "--out", "a.yaml", "--resolution", "0"), "from 0.001 to 100 m"),
            (("export", "rooms", "--out", "a.yaml", "--resolution", "nan"), "from 0.001 to 100 m"),
            (("export", "rooms", "--out", "nowhere/a.yaml"), "No such file"),
        ],
    )
    def test_what_is_wrong_is_one_line_and_nothing_is_written(
        self, run_cli: Cli, hall: str, arguments: tuple[str, ...], match: str
    ) -> None:
        before = sorted(Path().iterdir())
        code, out, err = run_cli("worlds", *arguments)
        assert (code, out, err.count("\n")) == (2, "", 1), err
        assert match in err
        assert sorted(Path().iterdir()) == before


class TestOtherVerbs:
    def test_a_drive_in_a_map_says_what_was_chosen(self, run_cli: Cli, hall: str) -> None:
        code, out, err = run_cli("drive", "straight", "--world", hall, "--sim", "kinematic", "--out", "d")
        assert code == 0
        assert "goal in world 'hall'" in out
        assert "hall.yaml: chosen: start (" in err
        code, _, err = run_cli(
            *("drive", "straight", "--world", hall, "--sim", "kinematic", "--out", "d"),
            *("--start", "-4,-2,0.5", "--target", "4,2"),
        )
        assert (code, "chosen" in err) == (0, False)
        world = load_recording(Path("d/trajectory.npz")).world
        assert (world.start.x, world.start.y, world.target) == (2.0, 2.0, (10.0, 6.0))

    def test_ends_are_part_of_a_run_and_of_what_an_evaluation_repeats(self, run_cli: Cli, hall: str) -> None:
        ends = ("--start", "-4,-2,0.5", "--target=4,2")
        kinematic = ("--sim", "kinematic", "--world", hall, *ends)
        assert run_cli("train", *kinematic, "--episodes", 1, "--out", "run")[0] == 0
        config = load_run(Path("run")).config
        assert (config.start, config.target, config.world) == ((-4.0, -2.0, 0.5), (4.0, 2.0), hall)
        assert changed_sources(Path("run")) == {}
        code, _, err = run_cli("evaluate", "run", "straight", *kinematic, "--workers", 1, "--out", "e")
        assert code == 0, err
        values = json.loads(Path("e/results.json").read_text())
        assert (values["start"], values["target"]) == ([-4.0, -2.0, 0.5], [4.0, 2.0])
        assert "--start -4,-2,0.5 --target 4,2" in values["command"]

    def test_a_picture_that_changes_under_a_run_is_noticed(self, run_cli: Cli, hall: str) -> None:
        assert run_cli("train", "--sim", "kinematic", "--world", hall, "--episodes", 1, "--out", "run")[0] == 0
        pixels = np.full((80, 120), 254, np.uint8)
        pixels[40, 60] = 0
        Image.fromarray(pixels).save("hall.pgm")
        assert list(changed_sources(Path("run"))) == [hall]
