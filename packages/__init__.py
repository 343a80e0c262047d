# SPDX-License-Identifier: GPL-3.0-or-later
"""Python packages made of this repository: `mrpnn`, and `mrpnn-kernels`, the compiled kernels.

    .venv/bin/python -m packages [--platform windows-x64 | all]

writes the wheel of `mrpnn-kernels` for this machine or another platform into wheels/, and its source distribution for
`all`. `pip install .` makes `mrpnn` (see backend.py).
"""
