//! Paper, font and files.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use plotters::coord::Shift;
use plotters::drawing::DrawingAreaErrorKind;
use plotters::prelude::{BitMapBackend, DrawingArea, DrawingBackend, IntoDrawingArea, SVGBackend, WHITE};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, FontStyle, RGBColor, TextStyle, register_font};

use peernet_analysis::{WriteError, write_file};

/// Pixels; [`PER_INCH`] to the inch at the 3.5 inches of a column.
pub(in crate::drawing) const SIZE: (u32, u32) = (1680, 1260);
const PER_INCH: f64 = 480.0;
/// Bytes of a PNG's signature and header (W3C, *Portable Network Graphics*, 5.2 and 11.2.1): what tells the size of its pixels
/// stands behind them.
const HEADER: usize = 8 + 25;
/// The chunk `pHYs` (ibid., 11.3.4.3): [`PER_INCH`] as 18,898 to the metre, and the checksum. Programs that set papers put
/// a picture without it at the resolution of a screen.
const DENSITY: [u8; 21] = *b"\0\0\0\x09pHYs\0\0\x49\xd2\0\0\x49\xd2\x01\xa8\x45\x8a\xf8";
/// Height of text, ascenders to descenders, pixels: type of 7 points at the width of a column.
pub(in crate::drawing) const TEXT: i32 = 57;
/// Height of notes, pixels: type of 6 points.
pub(in crate::drawing) const SMALL: i32 = 49;

const FAMILY: &str = "sans-serif";
const FONT: &[u8] = include_bytes!("../../../assets/inter.ttf");

/// How drawing on a backend ends.
pub type Drawn<DB, T = ()> = Result<T, DrawingAreaErrorKind<<DB as DrawingBackend>::ErrorType>>;

/// What is drawn on.
pub type Paper<DB> = DrawingArea<DB, Shift>;

/// A figure that could not be drawn.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cannot draw the figure: {0}")]
pub struct FigureError(String);

/// Something that can be drawn.
pub trait Figure {
    /// Width and height, pixels. The width is that of a column.
    fn size(&self) -> (u32, u32) {
        SIZE
    }

    /// Draws it on an empty area of paper.
    ///
    /// # Errors
    /// When the backend cannot.
    fn draw<DB: DrawingBackend>(&self, paper: &Paper<DB>) -> Drawn<DB>;

    /// The text of an SVG file.
    ///
    /// # Errors
    /// When it cannot be drawn.
    fn svg(&self) -> Result<String, FigureError> {
        let mut text = String::new();
        let (width, height) = self.size();
        on_paper(self, SVGBackend::with_string(&mut text, (width, height)))?;
        // As wide as a column wherever it is put, instead of so many pixels of a screen.
        let inches = |pixels: u32| f64::from(pixels) / PER_INCH;
        let pixels = format!("width=\"{width}\" height=\"{height}\"");
        let size = format!("width=\"{}in\" height=\"{}in\"", inches(width), inches(height));
        // Others are as wide as the font that the layout was made with, or narrower.
        let fonts = format!("font-family=\"Inter, Helvetica, Arial, {FAMILY}\"");
        Ok(text.replacen(&pixels, &size, 1).replace(&format!("font-family=\"{FAMILY}\""), &fonts))
    }

    /// Pixels, three bytes each, row by row.
    ///
    /// # Errors
    /// When it cannot be drawn.
    fn pixels(&self) -> Result<Vec<u8>, FigureError> {
        let size = self.size();
        let mut pixels = vec![0; size.0 as usize * size.1 as usize * 3];
        on_paper(self, BitMapBackend::with_buffer(&mut pixels, size))?;
        Ok(pixels)
    }

    /// Writes `STEM.png` and `STEM.svg` into a folder.
    ///
    /// # Errors
    /// When it cannot be drawn or a file not be written.
    fn write(&self, folder: &Path, stem: &str) -> Result<[PathBuf; 2], WriteError> {
        let files = ["png", "svg"].map(|ending| folder.join(format!("{stem}.{ending}")));
        let pixels = self.pixels().map_err(WriteError::at(&files[0]))?;
        let (width, height) = self.size();
        let mut png = Vec::new();
        // Large areas of one colour: a filter would only hide that from the compression.
        PngEncoder::new_with_quality(&mut png, CompressionType::Default, FilterType::NoFilter)
            .write_image(&pixels, width, height, ExtendedColorType::Rgb8)
            .map_err(WriteError::at(&files[0]))?;
        png.splice(HEADER..HEADER, DENSITY);
        write_file(&files[0], &png)?;
        let svg = self.svg().map_err(WriteError::at(&files[1]))?;
        write_file(&files[1], svg.as_bytes())?;
        Ok(files)
    }
}

fn on_paper<F: Figure + ?Sized, DB: DrawingBackend>(figure: &F, backend: DB) -> Result<(), FigureError> {
    if !register() {
        return Err(FigureError("the font cannot be read".to_owned()));
    }
    let paper = backend.into_drawing_area();
    let drawn = paper.fill(&WHITE).and_then(|()| figure.draw(&paper)).and_then(|()| paper.present());
    drawn.map_err(|error| FigureError(error.to_string()))
}

/// Makes the font known; whether it can be read.
pub(super) fn register() -> bool {
    static REGISTERED: OnceLock<bool> = OnceLock::new();
    *REGISTERED.get_or_init(|| register_font(FAMILY, FontStyle::Normal, FONT).is_ok())
}

/// Text of a height and colour, anchored at a point.
pub(in crate::drawing) fn style(
    height: i32,
    colour: RGBColor,
    horizontal: HPos,
    vertical: VPos,
) -> TextStyle<'static> {
    TextStyle {
        color: colour.to_backend_color(),
        pos: Pos::new(horizontal, vertical),
        ..(FAMILY, height).into()
    }
}
