"""Volumetric rendering with predicted multiple scattering; numpy and onnxruntime only.

    layer = render([(volume, medium)], [sun], camera, Settings())
"""
