#!/usr/bin/env python3
"""The include-table check accepts what the table permits and names what it does not."""

from __future__ import annotations

import tempfile
import unittest
from pathlib import Path

import include_table


class IncludeTable(unittest.TestCase):
    """Each case starts from a small tree that keeps to the table."""

    def setUp(self) -> None:
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        self.cpp = Path(directory.name)
        self.module("core")
        self.module("dsp", "core")
        self.module("geometry", "core")
        self.module("estimation", "core")
        self.module("measurement", "core geometry")
        self.write("include/soopnav/core/iq.hpp", "#pragma once\n")
        self.write("src/dsp/fft.cpp", '#include "soopnav/dsp/fft.hpp"\n#include "soopnav/core/iq.hpp"\n')

    def module(self, name: str, uses: str = "") -> None:
        self.write(f"src/{name}/CMakeLists.txt", f"soopnav_add_module({name}\n  USES {uses}\n  PUBLIC Eigen3::Eigen)\n")

    def write(self, path: str, text: str) -> None:
        file = self.cpp / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")

    def assert_only(self, *expected: str) -> None:
        found = include_table.violations(self.cpp)
        self.assertEqual(len(found), len(expected), found)
        for problem, part in zip(found, expected, strict=True):
            self.assertIn(part, problem)

    def test_a_tree_that_keeps_to_the_table(self) -> None:
        self.assert_only()

    def test_an_include_of_an_unused_module_is_named_with_its_line(self) -> None:
        self.write("src/dsp/peak.cpp", "/* two\nlines */\n#  include <soopnav/estimation/chi_square.hpp>\n")
        self.assert_only("src/dsp/peak.cpp:3: dsp includes estimation")

    def test_estimation_and_measurement_do_not_know_each_other(self) -> None:
        self.write("include/soopnav/estimation/a.hpp", '#include "soopnav/measurement/range.hpp"\n')
        self.write("include/soopnav/measurement/b.hpp", '#include "soopnav/estimation/solve.hpp"\n')
        self.assert_only("estimation includes measurement", "measurement includes estimation")

    def test_an_include_in_a_subfolder_counts(self) -> None:
        self.module("waveform", "dsp")
        self.write("include/soopnav/waveform/lte/search.hpp", '#include "soopnav/geometry/frame.hpp"\n')
        self.assert_only("waveform includes geometry")

    def test_links_are_transitive(self) -> None:
        self.module("waveform", "dsp")
        self.write("src/waveform/lte/search.cpp", '#include "soopnav/core/iq.hpp"\n')
        self.assert_only()

    def test_a_link_line_the_table_lacks(self) -> None:
        self.module("estimation", "core measurement")
        self.assert_only("estimation: USES measurement")

    def test_a_receiver_never_links_the_simulation(self) -> None:
        self.module("simulation", "core waveform")
        self.module("waveform", "dsp")
        self.module("navigation", "estimation simulation")
        self.assert_only("navigation: USES simulation")

    def test_an_include_the_link_line_lacks_though_the_table_has_it(self) -> None:
        self.module("measurement", "core")
        self.write("src/measurement/range.cpp", '#include "soopnav/geometry/frame.hpp"\n')
        self.assert_only("measurement includes geometry, which its USES do not reach")

    def test_unknown_modules(self) -> None:
        self.module("radar", "core")
        self.module("dsp", "core sonar")
        self.assert_only("dsp: USES sonar", "radar: not in the table")

    def test_a_folder_that_adds_another_module(self) -> None:
        self.write("src/geometry/CMakeLists.txt", "soopnav_add_module(geodesy USES core)\n")
        self.assertIn("must add the module 'geometry'", "\n".join(include_table.violations(self.cpp)))

    def test_comments_do_not_count(self) -> None:
        self.write(
            "src/dsp/note.cpp", '// #include "soopnav/geometry/frame.hpp"\n/* #include "soopnav/vision/a.hpp"\n*/\n'
        )
        self.assert_only()

    def test_an_empty_tree_is_no_success(self) -> None:
        with tempfile.TemporaryDirectory() as empty:
            self.assertEqual(len(include_table.violations(Path(empty))), 2)


if __name__ == "__main__":
    unittest.main()
