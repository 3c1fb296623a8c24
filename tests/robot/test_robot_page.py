"""The example of `docs/robot.md` runs, and says what the page says."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "robot.md"


def test_the_simulator_of_the_page_finds_the_sticking_pointer(capsys):
    examples = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    example = next(e for e in examples if "class Balance" in e)
    exec(compile(example, str(PAGE), "exec"), {})
    assert capsys.readouterr().out.strip() == "('stuck',)"
