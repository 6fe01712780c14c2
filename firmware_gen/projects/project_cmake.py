"""The CMakeLists.txt of a firmware project: plain CMake, for Make and Ninja."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from firmware_gen.projects.board import Board, Flash

WARNINGS: Final = ("-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wmissing-prototypes")
ARITHMETIC: Final = ("-std=c99", "-ffp-contract=off")
"""Without these the controller does not compute the reference's bits; the selftest at boot would say so."""


def cmake_text(board: Board, sources: Sequence[str], stack: int = 0) -> str:
    """Write `CMakeLists.txt`.

    Args:
        board: the board
        sources: C files, relative to the project's folder
        stack: what the controller needs on top of the board's usual stack, for its linker script [bytes]
    """
    folder = "${CMAKE_CURRENT_SOURCE_DIR}"
    flags = (*ARITHMETIC, *WARNINGS, *board.flags)
    bare = "link.ld" in {path.name for path in board.files}
    whole = (*ARITHMETIC, "-flto") if bare else ()
    links = [flag.replace("{board}", f"{folder}/board") for flag in (*whole, *board.flags, *board.link_flags)]
    if bare and stack:
        links.append(f"-Wl,--defsym=program_stack={stack}")
    lines = [
        f"# Firmware for {board.name}, written by servolve firmware; do not edit.",
        "#",
        "#   cmake -B build && cmake --build build",
        "",
        "cmake_minimum_required(VERSION 3.20...3.31)",
        "if(NOT DEFINED CMAKE_TOOLCHAIN_FILE)",
        f"  set(CMAKE_TOOLCHAIN_FILE {folder}/board/toolchain.cmake)",
        "endif()",
        "project(firmware LANGUAGES C)",
        "",
        "add_executable(firmware",
        *(f"  {source}" for source in sources),
        ")",
        "target_include_directories(firmware PRIVATE src runtime board)",
        f"target_compile_options(firmware PRIVATE {_listed(flags)})",
        f"target_link_options(firmware PRIVATE {_listed(links)})",
    ]
    suffix = board.elf.removeprefix("firmware")
    if suffix:
        lines.append(f'set_target_properties(firmware PROPERTIES SUFFIX "{suffix}")')
    if bare:
        shared = " ".join(source for source in sources if not source.startswith("board/"))
        lines += [
            "# optimised as one, but for the board's own files: the linker script and debuggers know their functions",
            f"set_source_files_properties({shared} PROPERTIES COMPILE_OPTIONS -flto)",
        ]
        lines.append(f"set_target_properties(firmware PROPERTIES LINK_DEPENDS {folder}/board/link.ld)")
    if board.flash:
        lines += [
            "",
            "add_custom_command(TARGET firmware POST_BUILD",
            "  COMMAND ${CMAKE_OBJCOPY} -O binary $<TARGET_FILE:firmware> ${CMAKE_CURRENT_BINARY_DIR}/firmware.bin",
            "  VERBATIM)",
        ]
    for flash in board.flash:
        lines += _flash(flash)
    return "\n".join([*lines, ""])


def _flash(flash: Flash) -> list[str]:
    words = [
        word.replace("{elf}", "$<TARGET_FILE:firmware>").replace("{bin}", "${CMAKE_CURRENT_BINARY_DIR}/firmware.bin")
        for word in (flash.tool, *flash.command)
    ]
    return ["", f"add_custom_target({flash.target} COMMAND {_listed(words)}", "  DEPENDS firmware VERBATIM)"]


def _listed(words: Sequence[str]) -> str:
    return " ".join(f'"{word}"' if set(word) & set(' ;()#"') else word for word in words)
