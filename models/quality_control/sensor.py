"""The camera: exposure, colour of the light, vignette, glare, tone curve, blur, noise."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageFilter

from noise import blur
from scene import Scene


def expose(light: np.ndarray, face_brightness: float, scene: Scene, rng: np.random.Generator) -> Image.Image:
    """The 8-bit RGB picture of linear light [height, width, 3]; `face_brightness` is the mean of the top face."""
    height, width, _ = light.shape
    unit = width / 1280  # pixels of this picture per pixel of a picture 1280 wide
    camera = scene.camera
    light = (
        light
        * (camera.exposure / max(face_brightness, 0.05))
        * _tint(scene)
        * _vignette(height, width, camera.vignette)[..., None]
    )
    glare = np.maximum(light.mean(axis=2) - 0.8, 0)
    light += 0.25 * blur(glare, 40 * unit)[..., None]
    image = Image.fromarray((_tone(light) * 255 + 0.5).astype(np.uint8))
    image = image.filter(ImageFilter.GaussianBlur(camera.blur * unit))
    image = _motion_blurred(image, camera.motion * unit)
    if camera.sharpen > 0.1:
        image = image.filter(ImageFilter.UnsharpMask(1.5 * unit, round(100 * camera.sharpen), 1))
    return _with_noise(image, camera.noise, unit, rng)


def _tint(scene: Scene) -> np.ndarray:
    """The tint that the camera's white balance leaves: gains of red, green and blue."""
    warm = scene.light.temperature
    return np.array([1 + 0.14 * warm, 1 + 0.01 * warm, 1 - 0.16 * warm], np.float32)


def _vignette(height: int, width: int, strength: float) -> np.ndarray:
    """Gain [height, width], 1 in the middle."""
    x = np.linspace(-1, 1, width, dtype=np.float32)[None, :]
    y = np.linspace(-0.75, 0.75, height, dtype=np.float32)[:, None]
    return 1 / (1 + strength * (x**2 + y**2) / 1.2) ** 1.5


def _tone(light: np.ndarray) -> np.ndarray:
    """Screen values 0..1 from linear light: a curve that is flatter above a knee, then gamma and contrast."""
    knee = 0.6
    over = np.maximum(light - knee, 0)
    soft = np.minimum(light, knee) + (1 - knee) * (1 - np.exp(-over / (1 - knee)))
    level = np.linspace(0, 1, 4096) ** (1 / 2.2)
    table = (0.7 * level + 0.3 * level**2 * (3 - 2 * level)).astype(np.float32)
    return table[(np.clip(soft, 0, 1) * 4095).astype(np.int32)]


def _motion_blurred(image: Image.Image, length: float) -> Image.Image:
    """The picture, blurred over `length` pixels along the belt, because the belt moves during the exposure."""
    steps = round(length)
    if steps < 2:
        return image
    pixels = np.asarray(image, np.float32)
    total = sum(np.roll(pixels, k - steps // 2, axis=1) for k in range(steps))
    return Image.fromarray((total / steps + 0.5).astype(np.uint8))


def _with_noise(image: Image.Image, level: float, unit: float, rng: np.random.Generator) -> Image.Image:
    """The picture with shot noise and read noise; at mid grey and a width of 1280, `level` is about its deviation."""
    pixels = np.asarray(image, np.float32)
    grain = rng.standard_normal(pixels.shape[:2], np.float32)[..., None]
    colour = rng.standard_normal(pixels.shape, np.float32)
    strength = level * np.sqrt(unit) * (0.5 + 0.6 * np.sqrt(pixels / 255))
    pixels = pixels + strength * (0.85 * grain + 0.4 * colour)
    return Image.fromarray((np.clip(pixels, 0, 255) + 0.5).astype(np.uint8))
