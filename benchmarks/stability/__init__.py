"""Extreme scenes and single stages, each against an independent result and within a stated bound."""
