import pytest

from nnql_bullet import assets
from nnql_bullet.errors import UserError


@pytest.mark.parametrize(("kind", "name"), [("worlds", "paper"), ("worlds", "cover_2.5"), ("robots", "tricycle")])
def test_shipped_files_are_found_by_name(kind, name):
    path = assets.find(kind, name)
    assert path.is_file()
    assert path.name == f"{name}.toml"
    assert path.parent.name == kind


def test_a_file_is_found_by_its_absolute_path(tmp_path):
    path = tmp_path / "mine.toml"
    path.touch()
    assert assets.find("worlds", str(path)) == path


def test_a_file_is_found_by_its_path_from_the_working_directory(tmp_path, monkeypatch):
    (tmp_path / "mine.toml").touch()
    monkeypatch.chdir(tmp_path)
    assert assets.find("worlds", "mine.toml").resolve() == tmp_path / "mine.toml"


def test_a_folder_of_that_name_in_the_working_directory_hides_nothing(tmp_path, monkeypatch):
    (tmp_path / "paper").mkdir()
    monkeypatch.chdir(tmp_path)
    assert assets.find("worlds", "paper").name == "paper.toml"


@pytest.mark.parametrize("kind", ["worlds", "robots"])
@pytest.mark.parametrize("name", ["atlantis", "atlantis.toml", "/nowhere/atlantis.toml", "", "."])
def test_unknown_name_is_an_error_that_lists_the_shipped_ones(kind, name):
    with pytest.raises(UserError) as refusal:
        assets.find(kind, name)
    message = str(refusal.value)
    assert message.startswith(f"{kind}: there is no file '{name}'; give a path to a TOML file or one of: ")
    assert ("paper" if kind == "worlds" else "tricycle") in message
    assert "\n" not in message


def test_robots_are_not_found_among_the_worlds():
    with pytest.raises(UserError):
        assets.find("worlds", "tricycle")


@pytest.mark.parametrize("in_wheel", [True, False])
def test_installed_wheel_has_its_own_folder_and_a_checkout_has_it_beside_the_package(tmp_path, monkeypatch, in_wheel):
    package = tmp_path / "site-packages" / "nnql_bullet"
    folder = (package / "_data" if in_wheel else package.parent) / "worlds"
    folder.mkdir(parents=True)
    (folder / "only.toml").touch()
    monkeypatch.setattr(assets, "_PACKAGE", package)
    assert assets.folder("worlds") == folder
    assert assets.find("worlds", "only") == folder / "only.toml"
    with pytest.raises(UserError, match=r"one of: only$"):
        assets.find("worlds", "paper")
