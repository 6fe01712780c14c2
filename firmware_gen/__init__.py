"""Controllers as C for any machine: the transpiler, bounds on what it makes, and firmware projects for boards."""

from firmware_gen.report import report_text, write_report
from firmware_gen.transpiler.compiled import CompiledController, compile_controller, compile_controllers
from firmware_gen.transpiler.generate import Generated, Transpiled, generate, transpile

__all__ = [
    "CompiledController",
    "Generated",
    "Transpiled",
    "compile_controller",
    "compile_controllers",
    "generate",
    "report_text",
    "transpile",
    "write_report",
]
