# SPDX-License-Identifier: GPL-3.0-or-later
"""What several benchmarks share: the extension in this process, shaders, pictures and pages."""
