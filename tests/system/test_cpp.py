"""Two exports in one program of C++."""

import re
import shutil
import subprocess

import pytest
from exported import needs_cc

pytestmark = pytest.mark.slow
needs_cpp = pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")


@needs_cc
@needs_cpp
def test_two_sizes_in_one_program_of_cpp(runs, tmp_path):
    """With C++11 and 20; what is in the README is compiled, too."""
    for prefix, size in (("front_", "56x42"), ("down_", "64x48")):
        runs("export", "--size", size, "--prefix", prefix, "--out", prefix)
    (tmp_path / "main.cpp").write_text("""
#include "front_/front_dlgmd.h"
#include "down_/down_dlgmd.h"
#include <cstdint>
#include <cstdio>

int main()
{
    static front_dlgmd_state front;
    static down_dlgmd_state down;
    static std::uint8_t grey[DOWN_DLGMD_WIDTH * DOWN_DLGMD_HEIGHT];
    front_dlgmd_reset(&front);
    down_dlgmd_reset(&down);
    const front_dlgmd_answer a = front_dlgmd_step_us(&front, grey, 33333);
    const down_dlgmd_answer b = down_dlgmd_step_us(&down, grey, 33000);
    const bool is_near = a.ttc_s < 6.0F && b.ttc_s < 1.0F;
    std::printf("%d %d %d %d", FRONT_DLGMD_WIDTH, DOWN_DLGMD_WIDTH, is_near,
                front_dlgmd_side_of(&a).known);
    return 0;
}
""")
    objects = []
    for prefix in ("front_", "down_"):
        objects.append(f"{prefix}/{prefix}dlgmd.o")
        source = f"{prefix}/{prefix}dlgmd.c"
        subprocess.run(["cc", "-O1", "-c", source, "-o", objects[-1]], check=True, cwd=tmp_path)
    readme = (tmp_path / "front_" / "README.md").read_text()
    (tmp_path / "front_" / "loop.cpp").write_text(re.search("```cpp\n(.*?)```", readme, re.S)[1])
    for standard in (11, 20):
        strict = [f"-std=c++{standard}", "-Wall", "-Wextra", "-pedantic-errors", "-Werror"]
        compiled = ["g++", *strict, "main.cpp", *objects, "-o", "both"]
        subprocess.run(compiled, check=True, cwd=tmp_path)
        done = subprocess.run([tmp_path / "both"], capture_output=True, text=True, check=True)
        assert done.stdout == "56 64 0 0"
        loop = ["g++", *strict, "-c", "front_/loop.cpp", "-o", "loop.o"]
        subprocess.run(loop, check=True, cwd=tmp_path)
