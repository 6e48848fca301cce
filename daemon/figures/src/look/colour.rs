//! Colours: one table for pages and files.

use std::fmt;

/// Colour without transparency.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Rgb(pub u8, pub u8, pub u8);

impl Rgb {
    /// Returns the colour of `0xrrggbb`.
    pub const fn hex(value: u32) -> Self {
        Self((value >> 16) as u8, (value >> 8) as u8, value as u8)
    }

    /// Returns the opaque colour that looks like this colour with an opacity on white paper. Files thus need no
    /// transparency.
    #[must_use]
    pub fn tint(self, opacity: f64) -> Self {
        let mix = |channel: u8| (f64::from(channel) * opacity + 255.0 * (1.0 - opacity)).round() as u8;
        Self(mix(self.0), mix(self.1), mix(self.2))
    }

    /// Returns the contrast with another colour, from 1 to 21 (WCAG 2.1, relative luminance). Only the tests of the
    /// colour tables need the contrast.
    #[cfg(test)]
    pub(crate) fn contrast(self, other: Self) -> f64 {
        let linear = |channel: u8| {
            let encoded = f64::from(channel) / 255.0;
            if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
        };
        // WCAG adds 0.05 to both luminances for the light that a screen reflects, so that black has a finite contrast.
        let luminance = |colour: Self| {
            0.2126 * linear(colour.0) + 0.7152 * linear(colour.1) + 0.0722 * linear(colour.2) + 0.05
        };
        let (a, b) = (luminance(self), luminance(other));
        a.max(b) / a.min(b)
    }
}

impl fmt::Display for Rgb {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "#{:02x}{:02x}{:02x}", self.0, self.1, self.2)
    }
}

/// Colour of the dashboard in both themes. Files use the colour of the light theme.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Token {
    /// Name of the CSS custom property, without the two dashes before it.
    pub name: &'static str,
    /// Colour in the light theme and in files.
    pub light: Rgb,
    /// Colour in the dark theme.
    pub dark: Rgb,
}

impl Token {
    /// Returns a token from `0xrrggbb` for both themes.
    pub const fn new(name: &'static str, light: u32, dark: u32) -> Self {
        Self { name, light: Rgb::hex(light), dark: Rgb::hex(dark) }
    }
}

/// Colour of text, and of everything that is not a stage.
pub const INK: Token = Token::new("ink", 0x14_181f, 0xe8_ecf1);
/// Secondary text.
pub const INK_2: Token = Token::new("ink-2", 0x45_4d59, 0xb6_bec9);
/// Quiet text: axes and units.
pub const INK_3: Token = Token::new("ink-3", 0x62_6b78, 0x8e_98a6);
/// Lines between parts of a page.
pub const LINE: Token = Token::new("line", 0xe3_e7ec, 0x25_2c35);
/// Axes and the bars of totals.
pub const LINE_STRONG: Token = Token::new("line-strong", 0x8a_94a3, 0x5d_6877);
/// Background of a figure.
pub const SURFACE: Token = Token::new("surface", 0xff_ffff, 0x14_181e);
/// Failed iterations and errors.
pub const BAD: Token = Token::new("bad", 0x9b_1620, 0xff_9f98);

/// Tokens that do not belong to a stage.
pub const TOKENS: [Token; 7] = [INK, INK_2, INK_3, LINE, LINE_STRONG, SURFACE, BAD];

/// Background of a file.
pub const WHITE: Rgb = Rgb::hex(0xff_ffff);
/// Grid of a file: a little darker than the grid of a page, because a file is printed.
pub const GRID: Rgb = Rgb::hex(0xdd_e2e8);
/// Background of the periods that are excluded from the statistics, in a file.
pub const SHADE: Rgb = Rgb::hex(0xe8_ebef);
/// Text on a dark fill.
pub const ON_DARK: Rgb = WHITE;
/// Text on a pale fill.
pub const ON_PALE: Rgb = Rgb::hex(0x0b_0e13);
