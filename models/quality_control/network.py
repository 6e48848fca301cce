"""The convolutional network: it computes one map per class of defect, and the label from each map's strongest cell."""

from __future__ import annotations

import torch
from torch import nn

CHANNELS = (24, 48, 64)
CELL = 8  # pixels of the picture per cell of the maps
INITIAL_LOGIT = -3.5  # of each cell before the training; it is low because hardly any cell shows a defect


class Network(nn.Module):
    """Computes logits [n, defects + 1] of the labels from normalised pictures [n, 3, height, width]."""

    def __init__(self, defects: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        inputs = 3
        for channels in CHANNELS:
            layers += _convolution(inputs, channels, stride=2) + _convolution(channels, channels)
            inputs = channels
        layers += _convolution(inputs, inputs, dilation=2) + _convolution(inputs, inputs, dilation=2)
        self.features = nn.Sequential(*layers)
        self.locate = nn.Conv2d(inputs, defects, 1)
        nn.init.constant_(self.locate.bias, INITIAL_LOGIT)
        self.strongest = nn.Sequential(nn.AdaptiveMaxPool2d(1), nn.Flatten())
        self.decide = nn.Linear(defects, defects + 1)

    def maps(self, pictures: torch.Tensor) -> torch.Tensor:
        """For each cell, the logits of the defects that it may show: [n, defects, height / CELL, width / CELL]."""
        return self.locate(self.features(pictures))

    def classify(self, maps: torch.Tensor) -> torch.Tensor:
        """Logits [n, defects + 1] of the labels, from the maps."""
        return self.decide(self.strongest(maps))

    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        """Logits [n, defects + 1] of the labels, from the pictures."""
        return self.classify(self.maps(pictures))


def _convolution(inputs: int, outputs: int, stride: int = 1, dilation: int = 1) -> list[nn.Module]:
    """A 3x3 convolution (neighbouring taps are `dilation` pixels apart), a batch normalisation and a ReLU."""
    return [
        nn.Conv2d(inputs, outputs, 3, stride, padding=dilation, dilation=dilation, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(),
    ]
