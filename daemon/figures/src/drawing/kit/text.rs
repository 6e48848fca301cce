//! How wide text is, and making it fit.

use peernet_sample::printable_line;
use plotters::element::{Rectangle, Text};
use plotters::prelude::DrawingBackend;
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, TextStyle, WHITE};

use super::canvas::{Drawn, Paper, register, style};
use super::colour::INK;

/// Ground on both sides of text, pixels.
const AROUND: i32 = 8;

/// Draws text at a point, in one line: an SVG with a control character in it is none.
pub(in crate::drawing) fn text<DB: DrawingBackend>(
    paper: &Paper<DB>,
    words: impl Into<String>,
    (x, y): (i32, i32),
    style: TextStyle<'static>,
) -> Drawn<DB> {
    // The middle of a line's height is above the middle of its digits.
    let lower =
        if matches!(style.pos.v_pos, VPos::Center) { (style.font.get_size() / 9.0) as i32 } else { 0 };
    paper.draw(&Text::new(printable_line(&words.into()).into_owned(), (x, y + lower), style))
}

/// Draws text as [`text`] does, on ground of the paper's colour: what is below it, such as a grid, does not cross it.
pub(in crate::drawing) fn text_on_ground<DB: DrawingBackend>(
    paper: &Paper<DB>,
    words: &str,
    (x, y): (i32, i32),
    style: TextStyle<'static>,
) -> Drawn<DB> {
    let high = style.font.get_size() as i32;
    let wide = width(words, high);
    let left = match style.pos.h_pos {
        HPos::Left => x,
        HPos::Center => x - wide / 2,
        HPos::Right => x - wide,
    };
    let top = match style.pos.v_pos {
        VPos::Top => y,
        VPos::Center => y - high / 2,
        VPos::Bottom => y - high,
    };
    let ground = [(left - AROUND, top), (left + wide + AROUND, top + high)];
    paper.draw(&Rectangle::new(ground, WHITE.filled()))?;
    text(paper, words, (x, y), style)
}

/// Width of text of a height, pixels.
pub(in crate::drawing) fn width(text: &str, height: i32) -> i32 {
    register();
    let size = style(height, INK, HPos::Left, VPos::Top).font.box_size(&printable_line(text));
    // Without a font nothing is drawn either; a guess keeps the layout whole.
    size.map_or_else(|_| text.chars().count() as i32 * height / 2, |(width, _)| width as i32)
}

/// The text, or its beginning and its end around `…` where it is wider than there is room: what tells names apart is
/// often at their end.
pub(in crate::drawing) fn shorten(text: &str, height: i32, room: i32) -> String {
    if width(text, height) <= room {
        return text.to_owned();
    }
    let chars: Vec<char> = text.chars().collect();
    let cut = |count: usize| {
        let tail = count * 2 / 5;
        let part = |chars: &[char]| chars.iter().collect::<String>();
        let (head, tail) = (part(&chars[..count - tail]), part(&chars[chars.len() - tail..]));
        format!("{}…{}", head.trim_end(), tail.trim_start())
    };
    let fits = (0..chars.len()).rev().map(cut).find(|text| width(text, height) <= room);
    fits.unwrap_or_else(|| "…".to_owned())
}

/// The same for names that stand side by side. Those that would look alike lose what they have in common at their ends
/// instead: `…_s_…` and `…_m_…`.
pub(in crate::drawing) fn shorten_apart(names: &[&str], height: i32, room: i32) -> Vec<String> {
    let short: Vec<String> = names.iter().map(|name| shorten(name, height, room)).collect();
    let alike = |at: usize| -> Vec<&str> {
        let others =
            names.iter().zip(&short).filter(|(name, text)| **text == short[at] && **name != names[at]);
        others.map(|(name, _)| *name).collect()
    };
    let apart = |(at, text): (usize, &String)| {
        let others = alike(at);
        if others.is_empty() { text.clone() } else { shorten(&difference(names[at], &others), height, room) }
    };
    short.iter().enumerate().map(apart).collect()
}

/// What of a name is not in all of the others as well, with `…` for what is.
fn difference(name: &str, others: &[&str]) -> String {
    fn shared(a: impl Iterator<Item = char>, b: impl Iterator<Item = char>) -> usize {
        a.zip(b).take_while(|(a, b)| a == b).count()
    }
    let head = others.iter().map(|other| shared(name.chars(), other.chars())).min().unwrap_or_default();
    let tail = others.iter().map(|other| {
        let left = name.chars().count().min(other.chars().count()) - head;
        shared(name.chars().rev(), other.chars().rev()).min(left)
    });
    let tail = tail.min().unwrap_or_default();
    let middle: String = name.chars().skip(head).take(name.chars().count() - head - tail).collect();
    let end = |count: usize| if count > 0 { "…" } else { "" };
    format!("{}{middle}{}", end(head), end(tail))
}

/// Lines that fit, broken between words. A word that is wider than a line is shortened.
pub(in crate::drawing) fn wrap(text: &str, height: i32, room: i32) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ') {
        let longer = lines.last().map(|line| format!("{line} {word}"));
        match (longer.filter(|line| width(line, height) <= room), lines.last_mut()) {
            (Some(longer), Some(line)) => *line = longer,
            _ => lines.push(shorten(word, height, room)),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_are_shortened_stay_apart() {
        let long = ["s", "m", "xl"].map(|size| format!("efficientnet_v2_{size}_with_a_long_suffix_int8"));
        let mut names: Vec<&str> = long.iter().map(String::as_str).collect();
        names.extend(["resnet", "resnet"]);
        assert_eq!(shorten_apart(&names, 50, 250), ["…s…", "…m…", "…xl…", "resnet", "resnet"]);
        assert_eq!(shorten_apart(&names, 50, 5000), names);
        let nested = ["a model with a long name", "a model with a long name, a model with a long name"];
        let [one, other] = [0, 1].map(|at| shorten_apart(&nested, 50, 300)[at].clone());
        assert!(one != other && [&one, &other].iter().all(|text| width(text, 50) <= 300), "{one} {other}");
    }

    #[test]
    fn text_is_made_to_fit() {
        assert!(width("iterations", 50) > width("iter", 50));
        assert_eq!(shorten("short", 50, 1000), "short");
        let cut = shorten(&"a long label ".repeat(20), 50, 300);
        assert!(cut.starts_with("a lo") && cut.contains('…') && width(&cut, 50) <= 300, "{cut}");
        assert!(shorten("a model with a long name, small", 50, 400).ends_with("small"));
        let lines = wrap("so many words that they need several lines", 50, 300);
        assert!(lines.len() > 2 && lines.iter().all(|line| width(line, 50) <= 300), "{lines:?}");
        assert_eq!(lines.join(" "), "so many words that they need several lines");
        assert_eq!(wrap(&"x".repeat(100), 50, 300).len(), 1);
    }
}
