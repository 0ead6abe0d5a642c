import pytest

from nnql_bullet import assets
from nnql_bullet.errors import UserError


@pytest.mark.parametrize(("kind", "name"), [("worlds", "paper"), ("worlds", "cover_2.5"), ("robots", "tricycle")])
def test_shipped_files_are_found_by_name(kind, name):
    path = assets.find(kind, name)
    assert path.is_file()
    assert path.name == f"{name}.toml"
    assert path.parent.name == kind


def test_a_file_is_found_by_its_absolute_path_and_from_the_working_directory(tmp_path, monkeypatch):
    path = tmp_path / "mine.toml"
    path.touch()
    assert assets.find("worlds", str(path)) == path
    monkeypatch.chdir(tmp_path)
    assert assets.find("worlds", "mine.toml").resolve() == path


def test_a_folder_of_that_name_in_the_working_directory_hides_nothing(tmp_path, monkeypatch):
    (tmp_path / "paper").mkdir()
    monkeypatch.chdir(tmp_path)
    assert assets.find("worlds", "paper").name == "paper.toml"


@pytest.mark.parametrize(("kind", "shipped"), [("worlds", "paper"), ("robots", "tricycle")])
def test_unknown_name_is_an_error_that_lists_the_shipped_ones(kind, shipped):
    other = "tricycle" if kind == "worlds" else "paper"
    for name in ("atlantis", "atlantis.toml", "/nowhere/atlantis.toml", "", ".", other):
        with pytest.raises(UserError) as refusal:
            assets.find(kind, name)
        message = str(refusal.value)
        assert message.startswith(f"{kind}: there is no file '{name}'; give a path to a TOML file or one of: ")
        assert shipped in message
        assert "\n" not in message


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
