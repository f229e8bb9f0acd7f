"""Which folder is which package: three of them lie beside `meshpoint/` in the repository."""

from setuptools import find_packages, setup

BESIDE = ("controller", "dbc", "rig_sim")

setup(
    package_dir={f"meshpoint.{name}": name for name in BESIDE},
    packages=[
        *find_packages(include=["meshpoint", "meshpoint.*"]),
        *(
            f"meshpoint.{found}"
            for name in BESIDE
            for found in find_packages(include=[name, f"{name}.*"])
        ),
    ],
)
