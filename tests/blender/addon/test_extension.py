# SPDX-License-Identifier: GPL-3.0-or-later
"""The packed extension, validated, installed and used as an artist's Blender does it."""

import importlib.metadata
import importlib.util
import os
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

import followthrough

ROOT = Path(__file__).parents[3]

INSTALL_AND_BAKE = """
import sys
import bpy, addon_utils

bpy.ops.extensions.package_install_files(filepath=sys.argv[1], repo="user_default", enable_on_install=True)
assert addon_utils.check("bl_ext.user_default.followthrough")[1], "not enabled"

import followthrough
assert "extensions" in followthrough.__file__, followthrough.__file__

sys.path.insert(0, sys.argv[2])
import conftest
obj = conftest.make_character()
bpy.ops.followthrough.add()
obj.followthrough.cells = 8
assert bpy.ops.followthrough.bake() == {"FINISHED"}
assert len(obj.data.shape_keys.key_blocks) == 13
bpy.ops.preferences.addon_disable(module="bl_ext.user_default.followthrough")
assert not hasattr(bpy.types.Object, "followthrough")
print("INSTALLED AND BAKED")
"""


def load_tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("build_extension", ROOT / "tools" / "build_extension.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(ROOT / "tools"))  # as it is where the tool is run
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(ROOT / "tools"))
    return module


def pack_wheel(package: Path, name: str, version: str, tag: str, folder: Path) -> None:
    """Pack an importable package as the wheel that it could have come from."""
    info = f"{name}-{version}.dist-info"
    files = [path for path in package.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    with zipfile.ZipFile(folder / f"{name}-{version}-{tag}.whl", "w") as wheel:
        names = [str(Path(name, path.relative_to(package))) for path in files]
        for path, inside in zip(files, names, strict=True):
            wheel.write(path, inside)
        wheel.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        wheel.writestr(f"{info}/WHEEL", f"Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: {tag}\n")
        wheel.writestr(f"{info}/RECORD", "".join(f"{inside},,\n" for inside in names))


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """This Python's wheels of followthrough and tqdm."""
    folder = tmp_path_factory.mktemp("wheels")
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    tag = f"{python}-{python}-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
    pack_wheel(Path(followthrough.__file__).parent, "followthrough", load_tool().project_version(), tag, folder)
    tqdm = importlib.util.find_spec("tqdm")
    assert tqdm is not None and tqdm.origin is not None
    pack_wheel(Path(tqdm.origin).parent, "tqdm", importlib.metadata.version("tqdm"), "py3-none-any", folder)
    return folder


@pytest.fixture(scope="module")
def extension(wheels: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("dist")
    assert load_tool().main(["--wheels", str(wheels), "--output", str(output)]) == 0
    (zipped,) = output.glob("followthrough-*.zip")
    return zipped


def test_the_packed_manifest_names_what_is_packed(extension: Path) -> None:
    with zipfile.ZipFile(extension) as packed:
        manifest = tomllib.loads(packed.read("blender_manifest.toml").decode())
        names = packed.namelist()
    assert manifest["version"] == load_tool().project_version()
    assert len(manifest["wheels"]) == 2
    assert all(wheel.removeprefix("./") in names for wheel in manifest["wheels"])
    assert len(manifest["platforms"]) == 1
    assert "LICENSE" in names
    assert not [name for name in names if "__pycache__" in name]


def packages_without(hidden: tuple[str, ...], folder: Path) -> Path:
    """A folder with links to all that this Python has installed, but for packages whose names begin like these."""
    folder.mkdir()
    for entry in Path(sysconfig.get_path("platlib")).iterdir():
        if not entry.name.startswith(hidden):
            (folder / entry.name).symlink_to(entry)
    return folder


def test_it_installs_and_bakes(extension: Path, tmp_path: Path) -> None:
    environment = dict(os.environ)
    environment["PYTHONPATH"] = str(
        packages_without(("followthrough", "_followthrough", "tqdm"), tmp_path / "packages")
    )
    environment["BLENDER_USER_RESOURCES"] = str(tmp_path / "blender")
    result = subprocess.run(
        [sys.executable, "-S", "-c", INSTALL_AND_BAKE, str(extension), str(Path(__file__).parent)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert "INSTALLED AND BAKED" in result.stdout, result.stdout + result.stderr


@pytest.mark.parametrize(
    ("tag", "platforms"),
    [
        ("manylinux_2_28_x86_64", ["linux-x64"]),
        ("manylinux_2_27_aarch64.manylinux_2_28_aarch64", ["linux-arm64"]),
        ("linux_x86_64", ["linux-x64"]),
        ("win_amd64", ["windows-x64"]),
        ("win_arm64", ["windows-arm64"]),
        ("macosx_14_0_arm64", ["macos-arm64"]),
        ("macosx_11_0_universal2", ["macos-arm64", "macos-x64"]),
    ],
)
def test_platforms_are_named_as_blender_names_them(tag: str, platforms: list[str]) -> None:
    assert load_tool().blender_platforms([f"followthrough-1.0-cp311-cp311-{tag}.whl"]) == platforms


def test_an_old_wheel_is_refused(wheels: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "followthrough-0.0.1-cp311-cp311-linux_x86_64.whl").touch()
    (tqdm,) = wheels.glob("tqdm-*")
    (tmp_path / tqdm.name).touch()
    assert load_tool().main(["--wheels", str(tmp_path), "--output", str(tmp_path / "dist")]) == 1
    assert "0.0.1" in capsys.readouterr().err
    assert not (tmp_path / "dist").exists()


def test_a_folder_without_wheels_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert load_tool().main(["--wheels", str(tmp_path), "--output", str(tmp_path / "dist")]) == 1
    assert "found no wheel" in capsys.readouterr().err
