"""Synthetic skin: a subject's parameters, and its maps in any window of the chart."""

from models.lightstage.skin.anatomy import Anatomy
from models.lightstage.skin.atlas import Atlas, Metric
from models.lightstage.skin.subject import Subject
from models.lightstage.skin.synthesis import Skin, SkinMaps
from models.lightstage.skin.window import ChartWindow

__all__ = ["Anatomy", "Atlas", "ChartWindow", "Metric", "Skin", "SkinMaps", "Subject"]
