//! Functions that shorten text or break it into lines, so that it fits.

use super::width;

/// Returns the text. If the text is wider than `room`, its middle is replaced by `…`. The end of the text is kept,
/// because names often differ at the end. `room` has the unit of the type size `size`.
pub fn shorten(text: &str, size: f64, room: f64) -> String {
    if width(text, size) <= room {
        return text.to_owned();
    }
    let chars: Vec<char> = text.chars().collect();
    // Returns the text with this number of its characters, of which two in five are at the end.
    let keep_chars = |count: usize| {
        let tail_len = count * 2 / 5;
        let text_of = |chars: &[char]| chars.iter().collect::<String>();
        let (head, tail) = (text_of(&chars[..count - tail_len]), text_of(&chars[chars.len() - tail_len..]));
        format!("{}…{}", head.trim_end(), tail.trim_start())
    };
    // The width is not proportional to the number of characters, so every number is tried, the largest first.
    let longest_fitting = (0..chars.len()).rev().map(keep_chars).find(|text| width(text, size) <= room);
    longest_fitting.unwrap_or_else(|| "…".to_owned())
}

/// Shortens names that are shown together, so that different names remain different. If two names
/// would look alike without their middles, `…` replaces the beginning and the end that they share
/// instead: `net_s_int8` and `net_m_int8` become `…s…` and `…m…`.
pub fn shorten_distinctly(names: &[&str], size: f64, room: f64) -> Vec<String> {
    let shortened: Vec<String> = names.iter().map(|name| shorten(name, size, room)).collect();
    // Returns the other names whose shortened text is that of the name with this index.
    let look_alikes = |index: usize| -> Vec<&str> {
        let others = names
            .iter()
            .zip(&shortened)
            .filter(|(name, text)| **text == shortened[index] && **name != names[index]);
        others.map(|(name, _)| *name).collect()
    };
    let distinct_text = |(index, text): (usize, &String)| {
        let others = look_alikes(index);
        if others.is_empty() { text.clone() } else { shorten(&difference(names[index], &others), size, room) }
    };
    shortened.iter().enumerate().map(distinct_text).collect()
}

/// Returns the part of a name that differs from the other names. `…` replaces the beginning and the end that the name
/// shares with all other names.
fn difference(name: &str, others: &[&str]) -> String {
    fn common_len(a: impl Iterator<Item = char>, b: impl Iterator<Item = char>) -> usize {
        a.zip(b).take_while(|(a, b)| a == b).count()
    }
    let head_len =
        others.iter().map(|other| common_len(name.chars(), other.chars())).min().unwrap_or_default();
    let tail_len = others.iter().map(|other| {
        // The common end must not overlap the common beginning.
        let max_len = name.chars().count().min(other.chars().count()) - head_len;
        common_len(name.chars().rev(), other.chars().rev()).min(max_len)
    });
    let tail_len = tail_len.min().unwrap_or_default();
    let middle_len = name.chars().count() - head_len - tail_len;
    let middle: String = name.chars().skip(head_len).take(middle_len).collect();
    let ellipsis = |replaced_len: usize| if replaced_len > 0 { "…" } else { "" };
    format!("{}{middle}{}", ellipsis(head_len), ellipsis(tail_len))
}

/// Breaks a text between words into lines that are at most `room` wide. A word that is wider than a line is shortened.
pub fn wrap(text: &str, size: f64, room: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ') {
        let longer = lines.last().map(|line| format!("{line} {word}"));
        match (longer.filter(|line| width(line, size) <= room), lines.last_mut()) {
            (Some(longer), Some(line)) => *line = longer,
            _ => lines.push(shorten(word, size, room)),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shortened_names_remain_distinct() {
        let models = ["s", "m", "xl"].map(|size| format!("efficientnet_v2_{size}_with_a_long_suffix_int8"));
        let mut names: Vec<&str> = models.iter().map(String::as_str).collect();
        names.extend(["resnet", "resnet"]);
        assert_eq!(shorten_distinctly(&names, 50.0, 250.0), ["…s…", "…m…", "…xl…", "resnet", "resnet"]);
        assert_eq!(shorten_distinctly(&names, 50.0, 5000.0), names);
        let nested = ["a model with a long name", "a model with a long name, a model with a long name"];
        let [short, long] = [0, 1].map(|index| shorten_distinctly(&nested, 50.0, 300.0)[index].clone());
        assert!(
            short != long && [&short, &long].iter().all(|text| width(text, 50.0) <= 300.0),
            "{short} {long}"
        );
    }

    #[test]
    fn long_text_is_shortened_or_broken_into_lines() {
        assert_eq!(shorten("short", 50.0, 1000.0), "short");
        let shortened = shorten(&"a long label ".repeat(20), 50.0, 300.0);
        assert!(
            shortened.starts_with("a lo") && shortened.contains('…') && width(&shortened, 50.0) <= 300.0,
            "{shortened}"
        );
        assert!(shorten("a model with a long name, small", 50.0, 450.0).ends_with("small"));
        let lines = wrap("so many words that they need several lines", 50.0, 300.0);
        assert!(lines.len() > 2 && lines.iter().all(|line| width(line, 50.0) <= 300.0), "{lines:?}");
        assert_eq!(lines.join(" "), "so many words that they need several lines");
        assert_eq!(wrap(&"x".repeat(100), 50.0, 300.0).len(), 1);
    }
}
