"""ROS maps, MovingAI maps and GeoJSON: every trap of the formats, and what is written is read back."""

import json
from collections.abc import Callable
from math import cos, pi, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image
from shapely import Polygon, box, unary_union

import nnql_bullet as nb
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, Circle, OrientedBox, Pose, placed
from nnql_bullet.worlds.ends import choose_ends
from nnql_bullet.worlds.exporters import write_foreign
from nnql_bullet.worlds.importers import ForeignWorld, Reading, read_foreign
from nnql_bullet.worlds.importers.cells import merged_boxes
from nnql_bullet.worlds.spec import WorldSpec

HERE = Path("map")
FREE, SOLID, GREY = 254, 0, 205


def map_file(folder: Path, cells: Any, suffix: str = ".pgm", mode: str = "", **values: Any) -> Path:
    """A map of given pixels, the first row on top; its cells are 1 m wide."""
    pixels = np.array(cells, dtype=np.uint8)
    Image.fromarray(pixels).save(folder / f"map{suffix}")
    keys = {"image": f"map{suffix}", "resolution": 1.0, "origin": [0, 0, 0], "negate": 0}
    keys |= {"occupied_thresh": 0.65, "free_thresh": 0.196, **({"mode": mode} if mode else {}), **values}
    (folder / "map.yaml").write_text("".join(f"{key}: {value}\n" for key, value in keys.items()))
    return folder / "map.yaml"


def solid_cells(found: ForeignWorld, side: float = 1.0) -> list[str]:
    """A world as letters, the first row on top: # where a box lies, . elsewhere."""
    columns, rows = round(found.width / side), round(found.depth / side)
    grid = np.full((rows, columns), ".")
    for its in found.shapes:
        assert isinstance(its, OrientedBox)
        left, low = round((its.x - its.half_length) / side), round((its.y - its.half_width) / side)
        right, high = round((its.x + its.half_length) / side), round((its.y + its.half_width) / side)
        assert (grid[low:high, left:right] == ".").all(), "boxes overlap"
        grid[low:high, left:right] = "#"
    return ["".join(row) for row in grid[::-1]]


def refused(path: Path, match: str, **reading: Any) -> None:
    with pytest.raises(UserError, match=match) as refusal:
        read_foreign(path, Reading(**reading))
    assert "\n" not in str(refusal.value)


# Three rows: the upper right cell is solid, the lower left one is unknown.
PLAIN = [[FREE, FREE, SOLID], [FREE, FREE, FREE], [GREY, FREE, FREE]]


class TestRosMap:
    @pytest.mark.parametrize("suffix", [".pgm", ".png", ".bmp"])
    def test_the_first_row_of_the_picture_is_on_top(self, tmp_path: Path, suffix: str) -> None:
        found = read_foreign(map_file(tmp_path, PLAIN, suffix), Reading())
        assert solid_cells(found) == ["..#", "...", "#.."]
        assert (found.width, found.depth, found.frame) == (3.0, 3.0, Pose(0.0, 0.0, 0.0))

    def test_unknown_cells_are_solid_or_free_as_asked_and_counted(self, tmp_path: Path) -> None:
        path = map_file(tmp_path, PLAIN)
        found = read_foreign(path, Reading(unknown="free"))
        assert solid_cells(found) == ["..#", "...", "..."]
        assert "1 of 9 cells are unknown and count as free" in found.notes

    @pytest.mark.parametrize("threshold", [0.2, 0.25])
    def test_grey_205_is_unknown_even_where_the_threshold_of_map_savers_makes_it_free(
        self, tmp_path: Path, threshold: float
    ) -> None:
        """(255 - 205) / 255 is 0.196: below the 0.2 and 0.25 that savers write beside it."""
        path = map_file(tmp_path, PLAIN, free_thresh=threshold)
        found = read_foreign(path, Reading())
        assert solid_cells(found) == ["..#", "...", "#.."]
        assert any("205" in note and "thresholds" in note for note in found.notes)
        literal = read_foreign(path, Reading(grey="thresholds"))
        assert solid_cells(literal) == ["..#", "...", "..."]
        assert any("205" in note for note in literal.notes)

    def test_thresholds_are_strict(self, tmp_path: Path) -> None:
        """As in both map servers: equal to a threshold is between."""
        cells = [[FREE, 51, 204]]  # shares of 0.8 and 0.2
        path = map_file(tmp_path, cells, occupied_thresh=0.8, free_thresh=0.2)
        assert "2 of 3 cells are unknown and count as solid" in read_foreign(path, Reading()).notes

    def test_negated_maps_are_dark_where_they_are_free(self, tmp_path: Path) -> None:
        found = read_foreign(map_file(tmp_path, [[0, 255, 0], [0, 0, 0]], negate=1), Reading())
        assert solid_cells(found) == [".#.", "..."]

    def test_a_missing_mode_is_trinary_and_what_lies_between_thresholds_is_unknown(self, tmp_path: Path) -> None:
        found = read_foreign(map_file(tmp_path, [[254, 150, 254]]), Reading(unknown="free"))
        assert solid_cells(found) == ["..."]
        assert "1 of 3 cells are unknown and count as free" in found.notes

    def test_scale_says_how_many_cells_lie_between(self, tmp_path: Path) -> None:
        found = read_foreign(map_file(tmp_path, [[254, 150, 0, 254]], mode="scale"), Reading(unknown="free"))
        assert solid_cells(found) == ["..#."]
        assert "1 cells lie between the thresholds and count as unknown" in found.notes

    def test_raw_values_are_percent_and_above_100_unknown(self, tmp_path: Path) -> None:
        cells = [[0, 100, 66, 10, 255, 101, 50]]
        found = read_foreign(map_file(tmp_path, cells, mode="raw"), Reading(unknown="free"))
        assert solid_cells(found) == [".##...."]
        assert "3 of 7 cells are unknown and count as free" in found.notes
        assert "negate" in "".join(read_foreign(map_file(tmp_path, cells, mode="raw", negate=1), Reading()).notes)

    def test_transparent_pixels(self, tmp_path: Path) -> None:
        """Trinary averages transparency with the colours, as map servers do; in scale it makes a pixel unknown."""
        white = [255, 255, 255, 255]
        cells = [[white, [255, 255, 255, 0], [0, 0, 0, 255], [0, 0, 0, 0], white]]
        path = map_file(tmp_path, cells, ".png", mode="scale")
        assert solid_cells(read_foreign(path, Reading(unknown="free"))) == ["..#.."]
        path = map_file(tmp_path, cells, ".png")  # shares of 0, 0.25, 0.75 and 1
        found = read_foreign(path, Reading(unknown="free"))
        assert solid_cells(found) == ["..##."]
        assert "1 of 5 cells are unknown and count as free" in found.notes

    def test_colours_and_palettes_and_sixteen_bits_are_read_by_their_brightness(self, tmp_path: Path) -> None:
        path = map_file(tmp_path, [[FREE, SOLID, FREE]], ".png")
        for image in (
            Image.open(tmp_path / "map.png").convert("RGB"),
            Image.open(tmp_path / "map.png").convert("P"),
            Image.open(tmp_path / "map.png").convert("1"),
            Image.fromarray(np.array([[65000, 0, 65000]], dtype=np.uint16)),
        ):
            image.save(tmp_path / "map.png")
            assert solid_cells(read_foreign(path, Reading())) == [".#."], image.mode

    def test_outer_rows_and_columns_without_a_free_cell_are_the_walls_of_the_arena(self, tmp_path: Path) -> None:
        cells = np.full((5, 6), GREY)
        cells[1:3, 2:5] = FREE
        cells[1, 3] = SOLID
        found = read_foreign(map_file(tmp_path, cells, origin=[-10, 3, 0]), Reading())
        assert solid_cells(found) == [".#.", "..."]
        assert found.frame == Pose(-8.0, 5.0, 0.0)  # two columns to the right, two rows up

    def test_both_readings_of_the_yaw_of_the_origin(self, tmp_path: Path) -> None:
        """The cell (2, 2) has its centre 2.5 m along both turned axes; Nav2 takes the axes for not turned."""
        yaw = 0.3
        cells = np.full((4, 4), FREE)
        cells[1, 2] = SOLID
        path = map_file(tmp_path, cells, origin=[1, 2, yaw])
        for reading, turned in (("apply", yaw), ("ignore", 0.0)):
            found = read_foreign(path, Reading(yaw=reading))
            (its,) = found.shapes
            expected = 1 + 2.5 * cos(turned) - 2.5 * sin(turned), 2 + 2.5 * sin(turned) + 2.5 * cos(turned)
            assert placed(found.frame, its.x, its.y) == pytest.approx(expected)
            assert any("yaw" in note for note in found.notes)

    def test_numbers_as_yaml_writes_them(self, tmp_path: Path) -> None:
        """YAML 1.1 takes 5e-1 for text; map servers do not."""
        path = map_file(tmp_path, PLAIN, resolution="5e-1", origin="[1e0, -2, 0]", negate="false")
        found = read_foreign(path, Reading())
        assert (found.width, found.frame) == (1.5, Pose(1.0, -2.0, 0.0))

    @pytest.mark.parametrize(
        ("change", "match"),
        [
            ({"resolution": 0}, "'resolution' is the side of a cell"),
            ({"resolution": ".nan"}, "'resolution' must be a number"),
            ({"resolution": "[1]"}, "'resolution' must be a number"),
            ({"origin": [0, 0]}, "'origin' must be three numbers"),
            ({"origin": "[0, 0, .inf]"}, "'origin' must be a number"),
            ({"free_thresh": 0.9}, "free_thresh <= occupied_thresh"),
            ({"mode": "other"}, "'mode' must be one of"),
            ({"negate": 2}, "'negate' must be 0 or 1"),
            ({"image": "gone.pgm"}, "'gone.pgm' is not there"),
            ({"image": "map.yaml"}, "cannot be read as PGM or PNG"),
            ({"image": "."}, "is not there"),
            ({"image": "[1]"}, "must be the name"),
            ({"resolution": 100, "origin": [0, 0, 0]}, ""),
        ],
    )
    def test_what_is_wrong_in_the_yaml_is_named(self, tmp_path: Path, change: dict[str, Any], match: str) -> None:
        path = map_file(tmp_path, PLAIN, **change)
        if match:
            refused(path, match)
        else:
            assert read_foreign(path, Reading()).width == 300

    @pytest.mark.parametrize(
        ("text", "match"),
        [
            ("", "no key 'image'"),
            ("[1, 2]", "no key 'image'"),
            ("image: map.pgm\nresolution: 1\n", "'origin' must be"),
            ("image: map.pgm\norigin: [0, 0, 0]\n", "key 'resolution' is missing"),
            ("a: &a [x, x]\nb: &b [*a, *a]\nimage: map.pgm\n", "aliases"),
            ("image: !!python/object/apply:os.system ['true']\n", "cannot be read as YAML"),
            ("image: [" * 3000, "cannot be read as YAML|nested too deeply"),
            ("image: map.pgm\n" + "#" * 200_000, "up to 100000"),
            ("image: 'x", "cannot be read as YAML"),
        ],
    )
    def test_hostile_yaml_is_refused_in_one_line(self, tmp_path: Path, text: str, match: str) -> None:
        map_file(tmp_path, PLAIN)
        (tmp_path / "map.yaml").write_text(text)
        refused(tmp_path / "map.yaml", match)

    @pytest.mark.parametrize(
        ("content", "match"),
        [
            (b"P5\n1000000 1000000\n255\n", "cells; up to|cannot be read"),
            (b"P5\n3 3\n255\n\xfe\xfe", "cannot be read"),
            (b"P5\n0 3\n255\n", "no cells|cannot be read"),
            (b"P5\n3 3\n", "cannot be read"),
            (b"\x89PNG\r\n\x1a\n" + b"\0" * 30, "cannot be read"),
            (b"Pf\n1 1\n-1.0\n\0\0\x80\x3f", "cannot be read"),
            (b"GIF89a", "cannot be read"),
            (b"", "cannot be read"),
        ],
    )
    def test_damaged_and_huge_pictures_are_refused_before_they_are_read(
        self, tmp_path: Path, content: bytes, match: str
    ) -> None:
        path = map_file(tmp_path, PLAIN)
        (tmp_path / "map.pgm").write_bytes(content)
        refused(path, match)

    def test_a_map_without_a_free_cell_and_one_of_noise_are_refused(self, tmp_path: Path) -> None:
        refused(map_file(tmp_path, [[0, 0]]), "no cell of it is free")
        noise = np.indices((700, 700)).sum(axis=0) % 2 * 254
        refused(map_file(tmp_path, noise), "more than 100000 boxes")
        refused(map_file(tmp_path, noise[:, :30], resolution=2), "arenas are up to 1000 m")

    def test_a_picture_alone_is_refused_because_it_has_no_scale(self, tmp_path: Path) -> None:
        map_file(tmp_path, PLAIN)
        refused(tmp_path / "map.pgm", "give the YAML file")


@settings(max_examples=60, deadline=None)
@given(arrays(np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 12))))
def test_merged_boxes_cover_exactly_the_solid_cells_without_overlap(solid: Any) -> None:
    boxes = merged_boxes(solid, 0.05, HERE)
    count = np.zeros(solid.shape, int)
    for its in boxes:
        left, low = round((its.x - its.half_length) / 0.05), round((its.y - its.half_width) / 0.05)
        right, high = round((its.x + its.half_length) / 0.05), round((its.y + its.half_width) / 0.05)
        count[low:high, left:right] += 1
    assert (count == solid).all()


def test_a_rectangle_of_cells_is_one_box_and_a_cross_three() -> None:
    solid = np.zeros((5, 5), np.bool_)
    solid[1:4, 2:5] = True
    assert merged_boxes(solid, 1.0, HERE) == [OrientedBox(3.5, 2.5, 1.5, 1.5)]
    solid[:] = False
    solid[2, :] = solid[:, 2] = True
    assert len(merged_boxes(solid, 1.0, HERE)) == 3


def drawn(*shapes: Any, width: float = 6.0, depth: float = 4.0) -> WorldSpec:
    return WorldSpec("test", 0, width, depth, shapes, Pose(1, 1, 0), (5, 3), 0.5, 1.5)


class TestWritten:
    @pytest.mark.parametrize("yaw", [0.0, 0.5])
    def test_a_map_that_was_read_is_written_as_it_was(self, tmp_path: Path, yaw: float) -> None:
        rng = np.random.default_rng(0)
        cells = np.where(rng.random((30, 40)) < 0.2, SOLID, FREE)
        cells[[0, -1]] = cells[:, [0, -1]] = SOLID
        cells[1, 1:-1] = cells[-2, 1:-1] = cells[1:-1, 1] = cells[1:-1, -2] = FREE  # so that no more is trimmed
        path = map_file(tmp_path, cells, resolution=0.1, origin=[3, -7, yaw])
        found = read_foreign(path, Reading())
        world = WorldSpec("x", 0, found.width, found.depth, found.shapes, Pose(1, 1, 0), (2, 2), 0.5, 1.5)
        write_foreign(world, found.frame, tmp_path / "again.yaml", 0.1)
        assert (np.asarray(Image.open(tmp_path / "again.pgm")) == cells).all()
        again = read_foreign(tmp_path / "again.yaml", Reading())
        assert (again.shapes, again.width, again.depth) == (found.shapes, found.width, found.depth)
        assert (again.frame.x, again.frame.y, again.frame.yaw) == pytest.approx((*[found.frame.x, found.frame.y], yaw))

    def test_a_cell_is_solid_where_a_shape_reaches_into_it(self, tmp_path: Path) -> None:
        """Against shapely: cells that overlap the shapes, and those alone."""
        turned, round_one = OrientedBox(2.0, 2.0, 1.0, 0.3, 0.7), Circle(4.5, 2.5, 0.62)
        write_foreign(drawn(turned, round_one), Pose(0, 0, 0), tmp_path / "x.yaml", 0.25)
        pixels = np.asarray(Image.open(tmp_path / "x.pgm"))[::-1]
        assert pixels.shape == (18, 26)
        assert (pixels[[0, -1]] == SOLID).all() and (pixels[:, [0, -1]] == SOLID).all()
        shapes = unary_union([Polygon(turned.corners()), Polygon(disc_corners(round_one))])
        for row in range(16):
            for column in range(24):
                x, y = column * 0.25, row * 0.25
                area = shapes.intersection(box(x, y, x + 0.25, y + 0.25)).area
                if area > 1e-4 or area == 0:
                    assert (pixels[row + 1, column + 1] == SOLID) == (area > 0), (x, y)

    def test_a_thin_pole_is_not_lost(self, tmp_path: Path) -> None:
        write_foreign(drawn(Circle(3.01, 2.01, 0.01)), Pose(0, 0, 0), tmp_path / "x.yaml", 0.5)
        assert (np.asarray(Image.open(tmp_path / "x.pgm"))[1:-1, 1:-1] == SOLID).sum() == 1

    def test_names_that_yaml_would_take_for_something_else(self, tmp_path: Path) -> None:
        for name in ("it's #1: a.yaml", "no.yaml", "[x].yaml"):
            write_foreign(drawn(), Pose(0, 0, 0), tmp_path / name, 0.5)
            assert read_foreign(tmp_path / name, Reading()).width == 6.0


def disc_corners(circle: Circle) -> Array:
    angles = np.linspace(0, 2 * pi, 400)
    return np.column_stack([circle.x + circle.radius * np.cos(angles), circle.y + circle.radius * np.sin(angles)])


class TestMovingAi:
    def test_letters_and_the_first_row_on_top(self, tmp_path: Path) -> None:
        (tmp_path / "x.map").write_text("type octile\nheight 3\nwidth 5\nmap\n.GS@.\n.W.T.\n..O..\n")
        found = read_foreign(tmp_path / "x.map", Reading())
        assert solid_cells(found) == ["...#.", ".#.#.", "..#.."]
        assert "a cell is 1 m" in found.notes[1]
        assert read_foreign(tmp_path / "x.map", Reading(cell=0.2)).width == 1.0

    @pytest.mark.parametrize(
        ("text", "match"),
        [
            ("", "is not a MovingAI map"),
            ("type octile\nheight 2\nwidth 2\nmap\n..\n", "must have 2 rows of 2 cells"),
            ("type octile\nheight 1\nwidth 2\nmap\n...\n", "must have 1 rows of 2 cells"),
            ("type octile\nheight 1\nwidth 2\nmap\n.x\n", "no cell 'x'"),
            ("type octile\nheight 1\nwidth 2\nmap\n@@\n", "no cell of it is free"),
            ("type octile\nheight -1\nwidth 2\nmap\n", "is not a MovingAI map"),
            ("type octile\nheight 99999999\nwidth 99999999\nmap\n.\n", "up to 50000000"),
        ],
    )
    def test_what_is_wrong_is_named(self, tmp_path: Path, text: str, match: str) -> None:
        (tmp_path / "x.map").write_text(text)
        refused(tmp_path / "x.map", match)


def geojson(folder: Path, *polygons: Any, kind: str = "Polygon") -> Path:
    features = [{"type": "Feature", "properties": {}, "geometry": {"type": kind, "coordinates": p}} for p in polygons]
    path = folder / "x.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


SQUARE = [[0, 0], [4, 0], [4, 2], [0, 2], [0, 0]]


class TestGeoJson:
    def test_a_rectangle_is_a_box_turned_or_not(self, tmp_path: Path) -> None:
        turned = OrientedBox(10, 5, 2, 0.5, 0.4).corners()
        found = read_foreign(geojson(tmp_path, [SQUARE], [[*turned.tolist(), turned[0].tolist()]]), Reading())
        one, other = found.shapes
        x, y = placed(found.frame, one.x, one.y)
        assert (x, y, one.half_length, one.half_width) == (2, 1, 2, 1)
        assert isinstance(other, OrientedBox)
        moved = other.corners() + np.array([found.frame.x, found.frame.y])
        assert Polygon(moved).symmetric_difference(Polygon(turned)).area < 1e-5
        assert (found.frame.x, found.frame.y) == (-2.0, -2.0)  # the margin

    def test_other_polygons_are_the_cells_that_they_reach_into(self, tmp_path: Path) -> None:
        triangle = Polygon([(0.1, 0.1), (3.3, 0.4), (1.2, 2.7)], [[(1.1, 0.8), (1.9, 0.9), (1.4, 1.5)]])
        rings = [list(ring.coords) for ring in (triangle.exterior, *triangle.interiors)]
        found = read_foreign(geojson(tmp_path, rings), Reading(cell=0.1))
        boxes = [b for b in found.shapes if isinstance(b, OrientedBox)]
        corner = np.array([found.frame.x, found.frame.y])
        union = unary_union([Polygon(b.corners() + corner) for b in boxes])
        assert triangle.difference(union.buffer(1e-6)).area < 1e-9
        assert triangle.buffer(0.1 * 2**0.5 + 1e-6).covers(union)
        assert sum(b.area for b in boxes) == pytest.approx(union.area)  # none overlap
        assert "0.1 m" in "".join(found.notes)

    def test_degrees_are_projected_around_their_middle(self, tmp_path: Path) -> None:
        """A degree of latitude is 111.195 km on a sphere; at 60 degrees one of longitude is half of that."""
        a, b = 1e-4, 2e-4
        ring = [[10, 60], [10 + b, 60], [10 + b, 60 + a], [10, 60 + a], [10, 60]]
        found = read_foreign(geojson(tmp_path, [ring]), Reading(units="degrees"))
        (its,) = found.shapes
        assert isinstance(its, OrientedBox)
        assert (2 * its.half_length, 2 * its.half_width) == pytest.approx((11.12, 11.12), rel=1e-3)
        refused(geojson(tmp_path, [ring]), "give units degrees")
        refused(geojson(tmp_path, [[[500, 0], *SQUARE[1:-1], [500, 0]]]), "no degrees", units="degrees")

    def test_what_is_no_polygon_is_counted_as_left_out(self, tmp_path: Path) -> None:
        path = geojson(tmp_path, [SQUARE])
        values = json.loads(path.read_text())
        values["features"] += [{"type": "Feature", "geometry": {"type": "Point", "coordinates": [1, 2]}}] * 2
        path.write_text(json.dumps(values))
        assert read_foreign(path, Reading()).skipped == ("Point: only polygons are obstacles (2 times)",)

    @pytest.mark.parametrize(
        ("polygon", "match"),
        [
            ([SQUARE[:-1]], "does not end where it begins"),
            ([SQUARE[:2]], "at least four points"),
            ([[[0, 0], ["a", 0], [1, 1], [0, 0]]], "finite numbers"),
            ([[[0, 0], [1e9, 0], [1, 1], [0, 0]]], "finite numbers"),
            ([[[0, 0], [1, 1], [1, 0], [0, 1], [0, 0]]], "slanted polygon 1"),
            ([], "lists of rings"),
            (5, "lists of rings"),
            ([[[0, 0], [5000, 0], [5000, 1], [0, 1], [0, 0]]], "arenas are up to"),
        ],
    )
    def test_what_is_wrong_is_named(self, tmp_path: Path, polygon: Any, match: str) -> None:
        refused(geojson(tmp_path, polygon), match)

    def test_json_that_is_something_else(self, tmp_path: Path) -> None:
        for text in ("[]", "{}", '{"type": "Feature"}', "nothing", "[" * 5000):
            (tmp_path / "x.json").write_text(text)
            refused(tmp_path / "x.json", "GeoJSON|JSON|polygon|nested")


class TestEnds:
    def test_chosen_ends_are_far_apart_and_the_way_is_as_wide_as_asked(self) -> None:
        """A wall with a gap of 1 m, then one of 0.6 m: only two of the three rooms are joined for 0.75 m."""
        walls = [OrientedBox(10, 2, 0.1, 2), OrientedBox(10, 7.5, 0.1, 2.5), OrientedBox(20, 4.7, 0.1, 4.7)]
        world = drawn(*walls, width=30.0, depth=10.0)
        ends = choose_ends((30.0, 10.0), world.solids, 0.75)
        assert ends
        assert max(ends.start.x, ends.target[0]) < 20
        assert abs(ends.start.x - ends.target[0]) > 15
        narrow = choose_ends((30.0, 10.0), world.solids, 0.5)
        assert narrow
        assert abs(narrow.start.x - narrow.target[0]) > 25
        given = choose_ends((30.0, 10.0), world.solids, 0.75, start=(15.0, 5.0))
        assert given
        assert (given.start.x, given.start.y) == (15.0, 5.0)
        other = choose_ends((30.0, 10.0), world.solids, 0.75, target=(15.0, 5.0))
        assert other
        assert other.target == (15.0, 5.0)
        assert other.start.x < 3

    def test_the_start_looks_along_the_way(self) -> None:
        """The way leads up and around a wall, while the target is to the right."""
        world = drawn(OrientedBox(5, 4, 0.1, 4), width=10.0, depth=10.0)
        ends = choose_ends((10.0, 10.0), world.solids, 0.75, start=(3.0, 1.0), target=(7.0, 1.0))
        assert ends
        assert ends.start.yaw > 0.8

    def test_where_there_is_no_room_there_are_none(self) -> None:
        assert choose_ends((1.0, 1.0), drawn(width=1.0, depth=1.0).solids, 0.75) is None


class TestAsAWorld:
    @pytest.fixture
    def hall(self, tmp_path: Path) -> Path:
        """A hall of 12 m x 6 m with a pillar in its middle; its lower left corner is at (-5, 2)."""
        cells = np.full((62, 122), FREE)
        cells[[0, -1]] = cells[:, [0, -1]] = SOLID
        cells[26:36, 56:66] = SOLID
        return map_file(tmp_path, cells, resolution=0.1, origin=[-5.1, 1.9, 0])

    def test_a_map_is_a_world_by_its_path(self, hall: Path) -> None:
        world = nb.World.load(hall)
        assert (world.name, world.width, world.depth, world.origin) == ("map", 12.0, 6.0, (-5.0, 2.0))
        spec = world.draw(0)
        assert spec.bottleneck.width >= 0.75
        assert np.hypot(spec.start.x - spec.target[0], spec.start.y - spec.target[1]) > 8

    def test_ends_are_in_the_frame_of_the_map(self, hall: Path) -> None:
        found = nb.import_world(hall, start=(-4, 3, pi / 2), target=(6, 7))
        spec = found.world.draw(0)
        assert (spec.start.x, spec.start.y, spec.target) == (1.0, 1.0, (11.0, 5.0))
        assert spec.start.yaw == pytest.approx(pi / 2, abs=1e-6)
        assert found.chosen == ""
        again = nb.World.load(hall).between((-4, 3, pi / 2), (6, 7))
        assert again == found.world

    def test_what_is_chosen_is_said_in_the_frame_of_the_map(self, hall: Path) -> None:
        found = nb.import_world(hall, start=(-4, 3))
        spec = found.world.draw(0)
        x, y = placed(found.world.frame, *spec.target)
        assert f"target ({x:.2f}, {y:.2f})" in found.chosen
        assert "start (" not in found.chosen

    def test_a_turned_map_turns_the_start_too(self, tmp_path: Path) -> None:
        path = map_file(tmp_path, np.full((60, 60), FREE), resolution=0.1, origin=[1, 1, pi / 2])
        spec = nb.import_world(path, start=(-1, 2, pi), target=(-4, 5)).world.draw(0)
        assert (spec.start.x, spec.start.y, *spec.target) == pytest.approx((1.0, 2.0, 4.0, 5.0))
        assert spec.start.yaw == pytest.approx(pi / 2, abs=1e-6)

    @pytest.mark.parametrize(
        ("start", "match"),
        [((0, 0, 90), "radians"), ((99, 0), "outside the arena"), ((0,), "x,y"), ((float("nan"), 0), "x,y")],
    )
    def test_wrong_ends_are_refused(self, hall: Path, start: Any, match: str) -> None:
        with pytest.raises(UserError, match=match):
            nb.World.load(hall).between(start)

    def test_a_written_world_is_read_as_it_was(self, hall: Path, tmp_path: Path) -> None:
        world = nb.World.load(hall)
        nb.export_world(world, tmp_path / "map.toml")
        assert nb.World.load(tmp_path / "map.toml") == world
        nb.export_world("moving", tmp_path / "moving.toml", seed=4)
        assert nb.World.load(tmp_path / "moving.toml").draw(4).digest == nb.World.load("moving").draw(4).digest

    def test_a_map_without_room_is_refused_and_the_remedy_named(self, tmp_path: Path) -> None:
        with pytest.raises(UserError, match=r"no two places far apart .* give start and target"):
            nb.World.load(map_file(tmp_path, [[FREE, FREE]], resolution=0.05))

    def test_a_vehicle_that_does_not_fit_is_refused_when_it_drives(self, tmp_path: Path) -> None:
        """The way is 0.5 m wide; a vehicle of 0.65 m is not let in without a word."""
        cells = np.full((40, 200), FREE)
        cells[:, 95:105] = SOLID
        cells[15:20, 95:105] = FREE
        path = map_file(tmp_path, cells, resolution=0.1)
        world = nb.World.load(path)
        with pytest.raises(UserError, match=r"narrows to 0\.50 m"):
            world.between((3, 2), (17, 2)).draw(0)
        with pytest.raises(UserError, match=r"narrows to 0\.50 m"):
            nb.drive("straight", world=path, start=(3, 2), target=(17, 2), simulator="kinematic")


def test_every_format_is_chosen_by_its_suffix(tmp_path: Path) -> None:
    read: Callable[[Path], ForeignWorld] = lambda path: read_foreign(path, Reading())  # noqa: E731
    path = map_file(tmp_path, PLAIN)
    path.rename(tmp_path / "x.YML")
    assert read(tmp_path / "x.YML").format == "ROS map"
    refused(tmp_path / "gone.yaml", "no such file")
    (tmp_path / "folder.sdf").mkdir()
    refused(tmp_path / "folder.sdf", "is a folder")
