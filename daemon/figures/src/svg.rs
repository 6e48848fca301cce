//! Writer of SVG and of the few HTML elements around it. Tags and values are typed; text is escaped.
//!
//! ```
//! use peernet_figures::svg::{Share, Tag, Writer};
//!
//! let mut svg = Writer::default();
//! svg.element(Tag::Svg).set("class", "plot").open();
//! svg.element(Tag::Line).set("x1", Share(0.25)).set("x2", 12.5).leaf();
//! svg.element(Tag::Text).set("dy", ".36em").text("a < b");
//! svg.close();
//! assert_eq!(svg.finish(), r#"<svg class="plot"><line x1="25%" x2="12.5"/><text dy=".36em">a &lt; b</text></svg>"#);
//! ```

use std::fmt::Write as _;

use peernet_sample::printable_line;

use crate::look::Rgb;

/// Number of decimals of coordinates. Coordinates are thus exact to a thousandth of a point.
const DECIMALS: usize = 3;

/// Kind of element of SVG or HTML.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "each variant has the name of its element")]
pub enum Tag {
    Circle,
    Div,
    G,
    Li,
    Line,
    Path,
    Rect,
    Span,
    Svg,
    Text,
    Tspan,
    Ul,
}

impl Tag {
    const fn name(self) -> &'static str {
        match self {
            Self::Circle => "circle",
            Self::Div => "div",
            Self::G => "g",
            Self::Li => "li",
            Self::Line => "line",
            Self::Path => "path",
            Self::Rect => "rect",
            Self::Span => "span",
            Self::Svg => "svg",
            Self::Text => "text",
            Self::Tspan => "tspan",
            Self::Ul => "ul",
        }
    }
}

/// Share of a length from 0 to 1, written in percent.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Share(pub f64);

/// Length as a multiple of the type size, written in `em`.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Em(pub f64);

/// Length as a multiple of the page's root type size, written in `rem`.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Rem(pub f64);

/// Value of an attribute.
pub trait Value {
    /// Appends the value to `out`, escaped.
    fn append_to(&self, out: &mut String);
}

impl Value for f64 {
    fn append_to(&self, out: &mut String) {
        append_number(out, *self, DECIMALS);
    }
}

impl Value for Share {
    fn append_to(&self, out: &mut String) {
        append_number(out, self.0 * 100.0, DECIMALS);
        out.push('%');
    }
}

impl Value for Em {
    fn append_to(&self, out: &mut String) {
        append_number(out, self.0, DECIMALS);
        out.push_str("em");
    }
}

impl Value for Rem {
    fn append_to(&self, out: &mut String) {
        append_number(out, self.0, DECIMALS);
        out.push_str("rem");
    }
}

impl Value for Rgb {
    fn append_to(&self, out: &mut String) {
        let _ = write!(out, "{self}");
    }
}

impl Value for &str {
    fn append_to(&self, out: &mut String) {
        append_escaped(out, self);
    }
}

impl Value for String {
    fn append_to(&self, out: &mut String) {
        append_escaped(out, self);
    }
}

/// Writer of markup: elements and text.
#[derive(Clone, Debug, Default)]
pub struct Writer {
    out: String,
    /// Open elements, from the outermost to the innermost.
    open_tags: Vec<Tag>,
}

/// Element whose attributes are being written.
#[must_use = "an element ends with `leaf`, `open` or `text`"]
pub struct Attributes<'a> {
    writer: &'a mut Writer,
    tag: Tag,
}

impl Writer {
    /// Begins an element.
    pub fn element(&mut self, tag: Tag) -> Attributes<'_> {
        self.out.push('<');
        self.out.push_str(tag.name());
        Attributes { writer: self, tag }
    }

    /// Ends the innermost open element.
    pub fn close(&mut self) {
        if let Some(tag) = self.open_tags.pop() {
            self.write_end_tag(tag);
        }
    }

    /// Writes text into the innermost open element.
    pub fn text(&mut self, text: &str) {
        append_escaped(&mut self.out, text);
    }

    /// Appends the content of another writer.
    pub fn append(&mut self, other: Self) {
        self.out.push_str(&other.finish());
    }

    /// Closes all open elements and returns the markup.
    pub fn finish(mut self) -> String {
        while !self.open_tags.is_empty() {
            self.close();
        }
        self.out
    }

    fn write_end_tag(&mut self, tag: Tag) {
        self.out.push_str("</");
        self.out.push_str(tag.name());
        self.out.push('>');
    }
}

impl Attributes<'_> {
    /// Writes an attribute.
    #[expect(clippy::needless_pass_by_value, reason = "values are literals and small structs")]
    pub fn set(self, name: &'static str, value: impl Value) -> Self {
        let _ = write!(self.writer.out, " {name}=\"");
        value.append_to(&mut self.writer.out);
        self.writer.out.push('"');
        self
    }

    /// Writes an attribute unless its value is `None`.
    pub fn set_optional(self, name: &'static str, value: Option<impl Value>) -> Self {
        match value {
            Some(value) => self.set(name, value),
            None => self,
        }
    }

    /// Ends the element without content.
    pub fn leaf(self) {
        if matches!(self.tag, Tag::Div | Tag::Li | Tag::Span | Tag::Ul) {
            // HTML reads `<span/>` as the start tag of a span.
            self.text("");
        } else {
            self.writer.out.push_str("/>");
        }
    }

    /// Leaves the element open for nested elements. [`Writer::close`] ends it.
    pub fn open(self) {
        self.writer.out.push('>');
        self.writer.open_tags.push(self.tag);
    }

    /// Writes text as the content of the element and ends the element.
    pub fn text(self, text: &str) {
        self.writer.out.push('>');
        append_escaped(&mut self.writer.out, text);
        self.writer.write_end_tag(self.tag);
    }
}

/// Appends a number with at most `decimals` decimals and without trailing zeros. Appends 0 for a number that is not
/// finite, because SVG has no such numbers.
pub(crate) fn append_number(out: &mut String, value: f64, decimals: usize) {
    let value = if value.is_finite() { value } else { 0.0 };
    let start = out.len();
    let _ = write!(out, "{value:.decimals$}");
    if out[start..].contains('.') {
        let trimmed_len = out.trim_end_matches('0').trim_end_matches('.').len();
        out.truncate(trimmed_len.max(start));
    }
    if matches!(&out[start..], "-0" | "") {
        out.replace_range(start.., "0");
    }
}

/// Appends text with its markup characters escaped. Control characters and the noncharacters U+FFFE and U+FFFF become
/// spaces, because an SVG with these characters is not valid XML (W3C, *XML 1.0*, 2.2).
fn append_escaped(out: &mut String, text: &str) {
    for character in printable_line(text).chars() {
        match character {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\u{fffe}' | '\u{ffff}' => out.push(' '),
            other => out.push(other),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_finite_without_trailing_zeros() {
        let text = |value: f64| {
            let mut out = "=".to_owned();
            append_number(&mut out, value, DECIMALS);
            out
        };
        let values = [0.0, -0.0001, 100.0, 12.345_67, -3.5, f64::NAN, f64::INFINITY, 1e7];
        assert_eq!(values.map(text), ["=0", "=0", "=100", "=12.346", "=-3.5", "=0", "=0", "=10000000"]);
    }

    #[test]
    fn markup_in_text_is_escaped() {
        let mut svg = Writer::default();
        svg.element(Tag::Div).set("class", "\"><script>").open();
        svg.text("<b>&\u{7}");
        svg.element(Tag::Span).leaf();
        let text = svg.finish();
        assert!(!text.contains("<script>") && !text.contains("<b>") && !text.contains('\u{7}'), "{text}");
        assert!(text.ends_with("<span></span></div>"), "{text}");
    }
}
