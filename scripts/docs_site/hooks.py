"""What MkDocs calls while it builds the site: generated pages, generated figures, and the check of the README.

In a page, `{{ name argument ... }}` is replaced by what the function of that name gives; %20 is a space in an argument.
A name or an argument that does not exist fails the build.

    python scripts/docs_site/hooks.py            # writes what is generated into README.md
    python scripts/docs_site/hooks.py --check    # refuses what does not stand: see `claims`
"""

import argparse
import re
import sys
from pathlib import Path
from typing import Any

import claims
import site_package
import site_results

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
BLOCK = re.compile(r"(?s)(<!-- results: begin[^>]*-->\n)(.*?)(\n<!-- results: end -->)")

FUNCTIONS = {
    name: getattr(module, name)
    for module, names in (
        (
            site_results,
            "success outcome share number success_table shield_table conditions_table difference ablation_success "
            "ablation_power section results_list",
        ),
        (site_package, "configuration world_keys robot_keys presets command_line layers api_index policy_cards"),
    )
    for name in names.split()
}


def on_config(config: Any) -> Any:
    """Adds the generated pages to the navigation."""
    for entry in config.nav:
        if "Results" in entry:
            entry["Results"] += [
                {title: f"results/{folder}/index.md"} for folder, (title, *_) in site_results.PAGES.items()
            ]
        if "Reference" in entry:
            pages = [{title: f"reference/api/{name}.md"} for name, (title, *_) in site_package.api_pages().items()]
            for part in entry["Reference"]:
                if isinstance(part, dict) and "Python API" in part:
                    part["Python API"] = ["reference/api/index.md", *pages]
    return config


def on_files(files: Any, config: Any) -> Any:
    """Adds the generated pages, and the pictures of the reports."""
    from mkdocs.structure.files import File

    for folder in site_results.PAGES:
        files.append(File.generated(config, f"results/{folder}/index.md", content=site_results.report(folder)))
    for picture in sorted(site_results.RESULTS.rglob("*.png")):
        uri = f"results/{picture.relative_to(site_results.RESULTS).as_posix()}"
        files.append(File.generated(config, uri, abs_src_path=str(picture)))
    for name, (_, _, text) in site_package.api_pages().items():
        files.append(File.generated(config, f"reference/api/{name}.md", content=text))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Fills in what is generated."""
    from mkdocs.exceptions import PluginError

    try:
        return site_results.narrowed(claims.filled(markdown, FUNCTIONS))
    except claims.WrongClaim as error:
        raise PluginError(f"{page.file.src_uri}: {error}") from None


def on_pre_build(**_: Any) -> None:
    """Refuses a README and pages whose figures are not those of results/."""
    from mkdocs.exceptions import PluginError

    wrong = complaints()
    if wrong:
        raise PluginError("\n".join(wrong))


def complaints() -> list[str]:
    """Says what of the README and of the pages does not stand."""
    of_results = {name: function for name, function in FUNCTIONS.items() if function.__module__ == "site_results"}
    stale = readme() != README.read_text(encoding="utf-8")
    wrong = (
        ["README.md: its figures are not those of results/; run: python scripts/docs_site/hooks.py"] if stale else []
    )
    return wrong + claims.complaints(ROOT, of_results)


def readme() -> str:
    """The README with what is generated."""
    text = README.read_text(encoding="utf-8")
    return BLOCK.sub(lambda found: found[1] + site_results.readme_table() + found[3], text)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="change nothing; exit code 1 if something does not stand")
    if parser.parse_args().check:
        sys.exit("\n".join(complaints()) or 0)
    README.write_text(readme(), encoding="utf-8")
