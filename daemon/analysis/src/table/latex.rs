//! Tables as LaTeX.

use super::Table;

/// Greek letters with their commands. The text fonts of LaTeX do not have these letters.
const GREEK: [(char, &str); 34] = [
    ('α', "alpha"),
    ('β', "beta"),
    ('γ', "gamma"),
    ('δ', "delta"),
    ('ε', "varepsilon"),
    ('ζ', "zeta"),
    ('η', "eta"),
    ('θ', "theta"),
    ('ι', "iota"),
    ('κ', "kappa"),
    ('λ', "lambda"),
    ('μ', "mu"),
    ('ν', "nu"),
    ('ξ', "xi"),
    ('π', "pi"),
    ('ρ', "rho"),
    ('ς', "varsigma"),
    ('σ', "sigma"),
    ('τ', "tau"),
    ('υ', "upsilon"),
    ('φ', "varphi"),
    ('χ', "chi"),
    ('ψ', "psi"),
    ('ω', "omega"),
    ('Γ', "Gamma"),
    ('Δ', "Delta"),
    ('Θ', "Theta"),
    ('Λ', "Lambda"),
    ('Ξ', "Xi"),
    ('Π', "Pi"),
    ('Σ', "Sigma"),
    ('Φ', "Phi"),
    ('Ψ', "Psi"),
    ('Ω', "Omega"),
];

/// LaTeX command that scales a table down to the width of the page if the table is wider than the page. Names of
/// any length then fit.
const RESIZE_TO_PAGE: &str = "\\resizebox{\\ifdim\\width>\\linewidth \\linewidth\\else\\width\\fi}{!}{%";

pub(super) fn table(table: &Table, caption: &str) -> String {
    let columns: String =
        (0..table.header.len()).map(|column| if column < table.label_columns { 'l' } else { 'r' }).collect();
    let line = |cells: &[String], bold_column: Option<usize>| {
        let cell = |(column, cell): (usize, &String)| {
            let is_bold = bold_column == Some(column);
            if is_bold { format!("\\textbf{{{}}}", escape(cell)) } else { escape(cell) }
        };
        format!("{} \\\\\n", cells.iter().enumerate().map(cell).collect::<Vec<_>>().join(" & "))
    };
    let marked_column =
        |row: usize| table.marked.filter(|(marked, _)| *marked == row).map(|(_, column)| column);
    let rows = table.rows.iter().enumerate();
    let rows: String = rows.map(|(row, cells)| line(cells, marked_column(row))).collect();
    let (header, caption) = (line(&table.header, None), escape(caption));
    let fonts = fonts([&header, &rows, &caption].into_iter().flat_map(|text| text.chars()));
    format!(
        "% needs \\usepackage{{booktabs,graphicx}}\n{fonts}\\begin{{table*}}\n\\centering\n\\setlength{{\\tabcolsep}}{{4pt}}\n{RESIZE_TO_PAGE}\n\
         \\begin{{tabular}}{{{columns}}}\n\\toprule\n{header}\\midrule\n{rows}\\bottomrule\n\\end{{tabular}}}}\n\
         \\caption{{{caption}}}\n\\end{{table*}}\n"
    )
}

/// Returns a comment that names the fonts or the program that these letters need; empty if all letters are ASCII.
fn fonts(chars: impl Iterator<Item = char>) -> String {
    let (mut has_latin, mut other_letters) = (false, Vec::new());
    for char in chars.filter(|char| !char.is_ascii()) {
        if is_latin(char) { has_latin = true } else { other_letters.push(char) }
    }
    other_letters.sort_unstable();
    other_letters.dedup();
    if other_letters.is_empty() {
        return if has_latin { "% needs \\usepackage[T1]{fontenc}\n".to_owned() } else { String::new() };
    }
    let other_letters: String = other_letters.into_iter().collect();
    format!("% needs LuaLaTeX or XeLaTeX, and a font that has {other_letters}\n")
}

/// Returns whether pdfLaTeX can print the letter with fonts in the encoding T1. It can print Latin-1 and Latin
/// Extended-A with few exceptions, and some punctuation.
const fn is_latin(char: char) -> bool {
    !matches!(char, 'Ħ' | 'ħ' | 'ĸ' | 'Ŀ' | 'ŀ' | 'ŉ' | 'Ŧ' | 'ŧ') && char <= 'ž'
        || matches!(char, '‘' | '’' | '‚' | '“' | '”' | '„' | '†' | '‡' | '•' | '…' | '‰' | '€' | '™')
}

/// Escapes any text, so that LaTeX prints exactly this text. No part of the result can act as a command, as an argument
/// of the command before it, or as a ligature. Invisible characters, such as control characters, become a blank or are
/// removed.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let is_dash = |char: char| matches!(char, '-' | '–' | '—');
    let mut previous = ' ';
    for char in text.chars() {
        // LaTeX would join neighbouring dashes to a longer dash.
        if is_dash(char) && is_dash(previous) {
            out.push_str("{}");
        }
        match char {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', char]),
            // At the beginning of a row, LaTeX would read these characters as arguments of the `\\` that ends the row
            // before.
            '[' | ']' | '*' => out.extend(['{', char, '}']),
            // Two equal characters of this kind would become one quotation mark.
            '\'' | ',' | '`' if previous == char => out.extend(['{', '}', char]),
            '`' if matches!(previous, '?' | '!') => out.push_str("{}`"),
            '\\' => out.push_str("\\textbackslash{}"),
            '~' => out.push_str("\\textasciitilde{}"),
            '^' => out.push_str("\\textasciicircum{}"),
            '|' => out.push_str("\\textbar{}"),
            '<' => out.push_str("$<$"),
            '>' => out.push_str("$>$"),
            '±' => out.push_str("$\\pm$"),
            '−' => out.push_str("$-$"),
            '≥' => out.push_str("$\\geq$"),
            '≤' => out.push_str("$\\leq$"),
            '≈' => out.push_str("$\\approx$"),
            '≠' => out.push_str("$\\neq$"),
            '→' => out.push_str("$\\rightarrow$"),
            '←' => out.push_str("$\\leftarrow$"),
            '·' => out.push_str("$\\cdot$"),
            '\u{a0}' => out.push('~'),
            '\u{2009}' | '\u{202f}' => out.push_str("\\,"),
            '∞' => out.push_str("$\\infty$"),
            '×' => out.push_str("$\\times$"),
            '÷' => out.push_str("$\\div$"),
            'µ' => out.push_str("$\\mu$"),
            '–' => out.push_str("--"),
            '—' => out.push_str("---"),
            // Invisible: soft hyphens, joiners, marks of writing direction, line separators, the byte order mark.
            '\u{ad}'
            | '\u{200b}'..='\u{200f}'
            | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}'
            // Their neighbours come together, so `previous` stays the same.
            | '\u{feff}' => continue,
            _ if char.is_control() || char.is_whitespace() => out.push(' '),
            _ => match GREEK.iter().find(|(letter, _)| *letter == char) {
                Some((_, name)) => out.extend(["$\\", name, "$"]),
                None => out.push(char),
            },
        }
        previous = char;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn special_characters_are_escaped() {
        assert_eq!(
            escape("a_b & 50 % {#1} ~x^2 \\n"),
            "a\\_b \\& 50 \\% \\{\\#1\\} \\textasciitilde{}x\\textasciicircum{}2 \\textbackslash{}n"
        );
        assert_eq!(escape("−1.5 ± 0.2, 1 – 2, —"), "$-$1.5 $\\pm$ 0.2, 1 -- 2, ---");
        assert_eq!(escape("robot → cluster, 5\u{202f}%"), "robot $\\rightarrow$ cluster, 5\\,\\%");
        assert_eq!(escape("a|b <c> λ=2 ÷ 3"), "a\\textbar{}b $<$c$>$ $\\lambda$=2 $\\div$ 3");
    }

    #[test]
    fn escaped_text_has_no_arguments_or_ligatures() {
        assert_eq!(escape("[x] *"), "{[}x{]} {*}", "LaTeX would read [, ] and * as arguments of \\\\");
        assert_eq!(escape("a--b --- ''x'' ``y`` ,, ?`"), "a-{}-b -{}-{}- '{}'x'{}' `{}`y`{}` ,{}, ?{}`");
        assert_eq!(escape("a-–b —- -\u{ad}-"), "a-{}--b ---{}- -{}-");
    }

    #[test]
    fn invisible_characters_are_removed() {
        assert_eq!(escape("tab\tnew\nline\r\u{1b}[2J\u{0}\u{7}\u{7f}\u{85}."), "tab new line  {[}2J    .");
        assert_eq!(
            escape("\u{feff}zero\u{200b}width\u{202e}\u{2028}, soft\u{ad}hyphen"),
            "zerowidth, softhyphen"
        );
        let all: String = (0..=0x2fff).filter_map(char::from_u32).collect();
        assert!(!escape(&all).chars().any(char::is_control));
    }

    fn rows(rows: &[[&str; 2]]) -> Table {
        Table {
            header: vec!["model".to_owned(), "ms".to_owned()],
            label_columns: 1,
            rows: rows.iter().map(|row| row.map(str::to_owned).to_vec()).collect(),
            marked: Some((0, 1)),
        }
    }

    #[test]
    fn table_uses_booktabs() {
        assert_eq!(
            rows(&[["a_1", "1.0 ± 0.1"], ["b", "2.0"]]).latex("Two & more"),
            "% needs \\usepackage{booktabs,graphicx}\n\\begin{table*}\n\\centering\n\\setlength{\\tabcolsep}{4pt}\n\
             \\resizebox{\\ifdim\\width>\\linewidth \\linewidth\\else\\width\\fi}{!}{%\n\
             \\begin{tabular}{lr}\n\\toprule\nmodel & ms \\\\\n\\midrule\na\\_1 & \\textbf{1.0 $\\pm$ 0.1} \\\\\n\
             b & 2.0 \\\\\n\\bottomrule\n\\end{tabular}}\n\\caption{Two \\& more}\n\\end{table*}\n"
        );
    }

    #[test]
    fn required_fonts_are_named() {
        let font_comment =
            |name: &str| rows(&[[name, "1"]]).latex("").lines().nth(1).unwrap_or_default().to_owned();
        // The table begins in the second line, because no comment names a font.
        assert_eq!(font_comment("5 µm, Ω → 2 × θ"), "\\begin{table*}");
        assert_eq!(font_comment("Größe é ł «x» đ ½ …"), "% needs \\usepackage[T1]{fontenc}");
        assert_eq!(font_comment("車車いす é ŧ"), "% needs LuaLaTeX or XeLaTeX, and a font that has ŧいす車");
    }
}
