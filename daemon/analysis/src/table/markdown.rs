//! Tables as Markdown.

use peernet_sample::printable_line;

use super::Table;

pub(super) fn table(table: &Table) -> String {
    let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
    let mut text = line(table.header.iter().map(|cell| escape(cell)).collect());
    text += &line(
        (0..table.header.len())
            .map(|column| if column < table.label_columns { "---" } else { "---:" }.to_owned())
            .collect(),
    );
    for (row, cells) in table.rows.iter().enumerate() {
        let cell = |(column, cell): (usize, &String)| {
            let is_marked = table.marked == Some((row, column));
            if is_marked { format!("**{}**", escape(cell)) } else { escape(cell) }
        };
        text += &line(cells.iter().enumerate().map(cell).collect());
    }
    text
}

/// Escapes characters that have a meaning in Markdown. Line breaks become blanks, because they would end the row.
fn escape(cell: &str) -> String {
    let mut text = String::with_capacity(cell.len());
    for char in printable_line(cell).chars() {
        match char {
            '\\' | '|' | '*' | '_' | '~' | '`' | '<' | '&' | '[' => text.extend(['\\', char]),
            _ => text.push(char),
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_cannot_break_the_table() {
        let table = Table {
            header: vec!["a|b".to_owned(), "n".to_owned()],
            label_columns: 1,
            rows: vec![
                vec!["x_y ~&lt;~".to_owned(), "1.0".to_owned()],
                vec!["*\nz".to_owned(), String::new()],
            ],
            marked: Some((0, 1)),
        };
        let expected = "| a\\|b | n |\n| --- | ---: |\n| x\\_y \\~\\&lt;\\~ | **1.0** |\n| \\* z |  |\n";
        assert_eq!(table.markdown(), expected);
    }
}
