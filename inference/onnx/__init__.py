# SPDX-License-Identifier: GPL-3.0-or-later
"""ONNX files evaluated with numpy alone, where onnxruntime is missing."""
