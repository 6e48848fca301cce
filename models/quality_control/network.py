"""The convolutional network: one map per kind of defect, and a decision from each map's strongest cell."""

from __future__ import annotations

import torch
from torch import nn

CHANNELS = (24, 48, 64)
CELL = 8  # pixels of the picture per cell of the maps
RARE = -3.5  # logit at the start of training, since hardly any cell shows a defect


class Network(nn.Module):
    """Normalised pictures [n, 3, height, width] to logits [n, defects + 1]."""

    def __init__(self, defects: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        before = 3
        for channels in CHANNELS:
            layers += _convolution(before, channels, stride=2) + _convolution(channels, channels)
            before = channels
        layers += _convolution(before, before, apart=2) + _convolution(before, before, apart=2)
        self.features = nn.Sequential(*layers)
        self.locate = nn.Conv2d(before, defects, 1)
        nn.init.constant_(self.locate.bias, RARE)
        self.strongest = nn.Sequential(nn.AdaptiveMaxPool2d(1), nn.Flatten())
        self.decide = nn.Linear(defects, defects + 1)

    def maps(self, pictures: torch.Tensor) -> torch.Tensor:
        """Logits that a cell shows a defect: [n, defects, height / CELL, width / CELL]."""
        return self.locate(self.features(pictures))

    def judge(self, maps: torch.Tensor) -> torch.Tensor:
        """Logits [n, defects + 1] from maps."""
        return self.decide(self.strongest(maps))

    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        """Logits [n, defects + 1]."""
        return self.judge(self.maps(pictures))


def _convolution(before: int, after: int, stride: int = 1, apart: int = 1) -> list[nn.Module]:
    """3x3 convolution whose nine taps are `apart` pixels from each other."""
    return [
        nn.Conv2d(before, after, 3, stride, padding=apart, dilation=apart, bias=False),
        nn.BatchNorm2d(after),
        nn.ReLU(),
    ]
