"""What several benchmarks share: the extension in this process, shaders, pictures and pages."""
