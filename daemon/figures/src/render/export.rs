//! Conversion of the SVG that [`file::svg`] makes into pixels and PDF. Only the embedded font is used.

use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use peernet_analysis::figure_files::FILE_ENDINGS;
use peernet_analysis::{WriteError, write_file};
use resvg::tiny_skia::{Pixmap, Transform};
use svg2pdf::{ConversionOptions, PageOptions};
use usvg::fontdb::Database;

use super::file;
use crate::plot::Figure;
use crate::text::{FAMILY, FONT};

/// Pixels of a PNG per inch.
pub const PIXELS_PER_INCH: f64 = 480.0;
/// Units of an SVG per inch (CSS, *Values and Units*, 6.2).
const UNITS_PER_INCH: f32 = 96.0;
/// Number of bytes of a PNG's signature and header (W3C, *Portable Network Graphics*, 5.2 and 11.2.1).
/// [`DENSITY_CHUNK`] is inserted after them.
const HEADER_BYTES: usize = 8 + 25;
/// Chunk `pHYs` (ibid., 11.3.4.3): [`PIXELS_PER_INCH`] as 18,898 pixels per metre, and the checksum. Without this
/// chunk, programs that typeset papers place a picture at the resolution of a screen.
const DENSITY_CHUNK: [u8; 21] = *b"\0\0\0\x09pHYs\0\0\x49\xd2\0\0\x49\xd2\x01\xa8\x45\x8a\xf8";

/// Error while an SVG is turned into pixels or PDF.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The SVG cannot be read.
    #[error("cannot read the SVG of the figure: {0}")]
    Svg(#[from] usvg::Error),
    /// There is not enough memory for the pixels.
    #[error("cannot draw the figure: there is no memory for {0} by {1} pixels")]
    Size(u32, u32),
    /// The pixels cannot be written.
    #[error("cannot write the PNG of the figure: {0}")]
    Png(#[from] image::ImageError),
    /// The PDF cannot be made.
    #[error("cannot make the PDF of the figure: {0}")]
    Pdf(String),
}

static FONTS: LazyLock<Arc<Database>> = LazyLock::new(|| {
    let mut fonts = Database::new();
    fonts.load_font_data(FONT.to_vec());
    fonts.set_sans_serif_family(FAMILY);
    Arc::new(fonts)
});

/// Figure as paths and positioned glyphs, which can be drawn as pixels or PDF.
pub struct ParsedFigure(usvg::Tree);

/// Pixels, three bytes each, row by row.
pub struct Pixels {
    /// Number of pixels of a row.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// Red, green and blue of each pixel.
    pub rgb: Vec<u8>,
}

impl ParsedFigure {
    /// Reads an SVG that [`file::svg`] made.
    ///
    /// # Errors
    /// If the text is not a valid SVG.
    pub fn of(svg: &str) -> Result<Self, ExportError> {
        let options = usvg::Options {
            dpi: UNITS_PER_INCH,
            font_family: FAMILY.to_owned(),
            fontdb: Arc::clone(&FONTS),
            ..usvg::Options::default()
        };
        Ok(Self(usvg::Tree::from_str(svg, &options)?))
    }

    /// Draws the figure.
    ///
    /// # Errors
    /// If there is not enough memory for the pixels.
    pub fn pixels(&self) -> Result<Pixels, ExportError> {
        let scale = PIXELS_PER_INCH as f32 / UNITS_PER_INCH;
        let size = self.0.size();
        let [width, height] = [size.width(), size.height()].map(|length| (length * scale).round() as u32);
        let mut pixmap = Pixmap::new(width, height).ok_or(ExportError::Size(width, height))?;
        resvg::render(&self.0, Transform::from_scale(scale, scale), &mut pixmap.as_mut());
        let mut rgb = pixmap.take();
        // The background is opaque, so alpha can be dropped. Alpha is dropped in place, because the pixels take most of
        // the memory.
        let pixel_count = rgb.len() / 4;
        for pixel in 0..pixel_count {
            rgb.copy_within(4 * pixel..4 * pixel + 3, 3 * pixel);
        }
        rgb.truncate(3 * pixel_count);
        Ok(Pixels { width, height, rgb })
    }

    /// Returns the figure as a PNG that states its resolution.
    ///
    /// # Errors
    /// If the figure cannot be drawn.
    pub fn png(&self) -> Result<Vec<u8>, ExportError> {
        let Pixels { width, height, rgb } = self.pixels()?;
        let mut png = Vec::new();
        // The picture has large areas of one colour, which compress better without a filter.
        PngEncoder::new_with_quality(&mut png, CompressionType::Default, FilterType::NoFilter).write_image(
            &rgb,
            width,
            height,
            ExtendedColorType::Rgb8,
        )?;
        png.splice(HEADER_BYTES..HEADER_BYTES, DENSITY_CHUNK);
        Ok(png)
    }

    /// Returns the figure as a PDF with one page, which is as large as the figure. Text stays text, in a subset of the
    /// embedded font.
    ///
    /// # Errors
    /// If the exporter fails.
    pub fn pdf(&self) -> Result<Vec<u8>, ExportError> {
        let page = PageOptions { dpi: UNITS_PER_INCH };
        let converted = svg2pdf::to_pdf(&self.0, ConversionOptions::default(), page);
        converted.map_err(|error| ExportError::Pdf(error.to_string()))
    }
}

/// Writes a figure into a folder as `STEM.png`, `STEM.svg` and `STEM.pdf`, and its caption as `STEM-caption.txt`.
/// Returns the paths of the files.
///
/// # Errors
/// If the figure cannot be drawn or a file cannot be written.
pub fn write(figure: &Figure, folder: &Path, stem: &str) -> Result<[PathBuf; 4], WriteError> {
    let files = FILE_ENDINGS.map(|ending| folder.join(format!("{stem}{ending}")));
    let [png_file, svg_file, pdf_file, caption_file] = &files;
    let svg = file::svg(figure);
    write_file(svg_file, svg.as_bytes())?;
    let parsed = ParsedFigure::of(&svg).map_err(WriteError::at(png_file))?;
    // A figure with many points is a long text, so the text is freed before the pixels are drawn.
    drop(svg);
    write_file(png_file, &parsed.png().map_err(WriteError::at(png_file))?)?;
    write_file(pdf_file, &parsed.pdf().map_err(WriteError::at(pdf_file))?)?;
    write_file(caption_file, figure.caption_text().as_bytes())?;
    Ok(files)
}
