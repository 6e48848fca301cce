//! Paper, font and files.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use plotters::coord::Shift;
use plotters::drawing::DrawingAreaErrorKind;
use plotters::prelude::{BitMapBackend, DrawingArea, DrawingBackend, IntoDrawingArea, SVGBackend, WHITE};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, FontStyle, RGBColor, TextStyle, register_font};

use crate::WriteError;
use crate::error::write;

/// Pixels; 480 to the inch at the 3.5 inches of a column.
pub(super) const SIZE: (u32, u32) = (1680, 1260);
/// Height of text, pixels: 7 points at the width of a column.
pub(super) const TEXT: i32 = 47;
/// Height of notes, pixels: 6 points.
pub(super) const SMALL: i32 = 40;

const FAMILY: &str = "sans-serif";
const FONT: &[u8] = include_bytes!("../../assets/inter.ttf");

/// How drawing on a backend ends.
pub type Drawn<DB> = Result<(), DrawingAreaErrorKind<<DB as DrawingBackend>::ErrorType>>;

/// A figure that could not be drawn.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cannot draw the figure: {0}")]
pub struct FigureError(String);

/// Something that can be drawn.
pub trait Figure {
    /// Draws it on an empty area of paper.
    ///
    /// # Errors
    /// When the backend cannot.
    fn draw<DB: DrawingBackend>(&self, paper: &DrawingArea<DB, Shift>) -> Drawn<DB>;

    /// The text of an SVG file.
    ///
    /// # Errors
    /// When it cannot be drawn.
    fn svg(&self) -> Result<String, FigureError> {
        let mut text = String::new();
        on_paper(self, SVGBackend::with_string(&mut text, SIZE))?;
        Ok(text)
    }

    /// Pixels, three bytes each, row by row.
    ///
    /// # Errors
    /// When it cannot be drawn.
    fn pixels(&self) -> Result<Vec<u8>, FigureError> {
        let mut pixels = vec![0; SIZE.0 as usize * SIZE.1 as usize * 3];
        on_paper(self, BitMapBackend::with_buffer(&mut pixels, SIZE))?;
        Ok(pixels)
    }

    /// Writes `STEM.png` and `STEM.svg` into a folder.
    ///
    /// # Errors
    /// When it cannot be drawn or a file not be written.
    fn write(&self, folder: &Path, stem: &str) -> Result<[PathBuf; 2], WriteError> {
        let files = ["png", "svg"].map(|ending| folder.join(format!("{stem}.{ending}")));
        let pixels = self.pixels().map_err(WriteError::at(&files[0]))?;
        image::save_buffer(&files[0], &pixels, SIZE.0, SIZE.1, image::ColorType::Rgb8)
            .map_err(WriteError::at(&files[0]))?;
        let svg = self.svg().map_err(WriteError::at(&files[1]))?;
        write(&files[1], svg.as_bytes())?;
        Ok(files)
    }
}

fn on_paper<F: Figure + ?Sized, DB: DrawingBackend>(figure: &F, backend: DB) -> Result<(), FigureError> {
    static REGISTERED: OnceLock<bool> = OnceLock::new();
    if !REGISTERED.get_or_init(|| register_font(FAMILY, FontStyle::Normal, FONT).is_ok()) {
        return Err(FigureError("the font cannot be read".to_owned()));
    }
    let paper = backend.into_drawing_area();
    let drawn = paper.fill(&WHITE).and_then(|()| figure.draw(&paper)).and_then(|()| paper.present());
    drawn.map_err(|error| FigureError(error.to_string()))
}

/// Text of a height and colour, anchored at a point.
pub(super) fn style(height: i32, colour: RGBColor, horizontal: HPos, vertical: VPos) -> TextStyle<'static> {
    TextStyle {
        color: colour.to_backend_color(),
        pos: Pos::new(horizontal, vertical),
        ..(FAMILY, height).into()
    }
}
