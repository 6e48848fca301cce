//! Tables as LaTeX.

use super::Table;

pub(super) fn table(table: &Table, caption: &str) -> String {
    let columns: String =
        (0..table.header.len()).map(|at| if at < table.labels { 'l' } else { 'r' }).collect();
    let line = |cells: &[String], bold: bool| {
        let cell = |cell: &String| match escape(cell) {
            cell if bold && !cell.is_empty() => format!("\\textbf{{{cell}}}"),
            cell => cell,
        };
        format!("{} \\\\\n", cells.iter().map(cell).collect::<Vec<_>>().join(" & "))
    };
    let rows = table.rows.iter().enumerate();
    let rows: String = rows.map(|(row, cells)| line(cells, table.marked.contains(&row))).collect();
    let (header, caption) = (line(&table.header, false), escape(caption));
    format!(
        "% needs \\usepackage{{booktabs}}\n\\begin{{table}}\n\\centering\n\\begin{{tabular}}{{{columns}}}\n\\toprule\n{header}\\midrule\n{rows}\\bottomrule\n\\end{{tabular}}\n\\caption{{{caption}}}\n\\end{{table}}\n"
    )
}

/// Text as LaTeX sets it, whatever is in it.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for char in text.chars() {
        match char {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', char]),
            '\\' => out.push_str("\\textbackslash{}"),
            '~' => out.push_str("\\textasciitilde{}"),
            '^' => out.push_str("\\textasciicircum{}"),
            '<' => out.push_str("$<$"),
            '>' => out.push_str("$>$"),
            '±' => out.push_str("$\\pm$"),
            '−' => out.push_str("$-$"),
            '≥' => out.push_str("$\\geq$"),
            '≤' => out.push_str("$\\leq$"),
            '≈' => out.push_str("$\\approx$"),
            '→' => out.push_str("$\\rightarrow$"),
            '·' => out.push_str("$\\cdot$"),
            '\u{a0}' => out.push('~'),
            '\u{202f}' => out.push_str("\\,"),
            '∞' => out.push_str("$\\infty$"),
            '×' => out.push_str("$\\times$"),
            'µ' => out.push_str("$\\mu$"),
            'θ' => out.push_str("$\\theta$"),
            '–' => out.push_str("--"),
            '—' => out.push_str("---"),
            '\n' | '\r' => out.push(' '),
            _ => out.push(char),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_set_as_it_reads() {
        assert_eq!(
            escape("a_b & 50 % {#1} ~x^2 \\n"),
            "a\\_b \\& 50 \\% \\{\\#1\\} \\textasciitilde{}x\\textasciicircum{}2 \\textbackslash{}n"
        );
        assert_eq!(escape("−1.5 ± 0.2, 1 – 2, —"), "$-$1.5 $\\pm$ 0.2, 1 -- 2, ---");
        assert_eq!(escape("robot → cluster, 5\u{202f}%"), "robot $\\rightarrow$ cluster, 5\\,\\%");
    }

    #[test]
    fn a_table_is_one_of_booktabs() {
        let table = Table {
            header: vec!["model".to_owned(), "ms".to_owned()],
            labels: 1,
            rows: vec![
                vec!["a_1".to_owned(), "1.0 ± 0.1".to_owned()],
                vec!["b".to_owned(), "2.0".to_owned()],
            ],
            marked: vec![0],
        };
        assert_eq!(
            table.latex("Two & more"),
            "% needs \\usepackage{booktabs}\n\\begin{table}\n\\centering\n\\begin{tabular}{lr}\n\\toprule\nmodel & ms \\\\\n\
             \\midrule\n\\textbf{a\\_1} & \\textbf{1.0 $\\pm$ 0.1} \\\\\nb & 2.0 \\\\\n\\bottomrule\n\\end{tabular}\n\
             \\caption{Two \\& more}\n\\end{table}\n"
        );
    }
}
