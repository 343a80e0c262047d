# SPDX-License-Identifier: GPL-3.0-or-later
"""The README's example runs as printed."""

import re

from tests.support.paths import ROOT


def test_the_example_runs(capsys):
    text = (ROOT / "README.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    scope = {}
    exec(code, scope)
    layer = scope["layer"]
    assert layer.rgb.shape == (90, 160, 3) and 0.9 < layer.alpha.max() <= 1.0
    assert layer.multiple.sum() > 0.0
    assert "(90, 160, 3)" in capsys.readouterr().out
