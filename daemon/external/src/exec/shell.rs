//! What can be told of a line for the shell by looking at it.

/// The program of a line that is one program and its arguments; `None` where that cannot be told by looking.
pub(super) fn only_program(line: &str) -> Option<&str> {
    let program = line.split_ascii_whitespace().next()?;
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"_-+./".contains(&byte);
    let more = [';', '&', '|', '\n', '(', ')', '{', '}', '`', '\0'];
    (program.bytes().all(is_plain) && !line.contains(more)).then_some(program)
}

/// The words of a line, without what quotes them; what a shell would put in the place of `$NAME` or `*` is not known.
pub(super) fn split(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    let mut chars = line.chars();
    while let Some(char) = chars.next() {
        match (quote, char) {
            (None, ' ' | '\t' | '\n') => words.extend(word.take()),
            (None, '\'' | '"') => {
                quote = Some(char);
                word.get_or_insert_default();
            }
            (Some(open), char) if char == open => quote = None,
            (None | Some('"'), '\\') => word.get_or_insert_default().extend(chars.next()),
            (_, char) => word.get_or_insert_default().push(char),
        }
    }
    words.extend(word);
    words
}

/// Programs, without the version behind their names, that run the first file among their arguments.
const INTERPRETERS: [&str; 20] = [
    "sh", "bash", "dash", "ash", "ksh", "zsh", "fish", "env", "python", "pypy", "perl", "ruby", "node",
    "deno", "bun", "php", "lua", "luajit", "julia", "Rscript",
];

/// The script that an interpreter is given; `None` of other programs, and behind `-c`, which says what to run itself.
pub(super) fn script(words: &[String], is_file: impl Fn(&str) -> bool) -> Option<&String> {
    let (program, arguments) = words.split_first()?;
    let name = program.rsplit('/').next().unwrap_or(program);
    let name = name.trim_end_matches(|char: char| char.is_ascii_digit() || char == '.');
    let mut arguments = arguments.iter().take_while(|argument| *argument != "-c");
    arguments.find(|argument| is_file(argument)).filter(|_| INTERPRETERS.contains(&name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_what_a_shell_makes_of_them() {
        for (line, words) in [
            ("sh own.sh  --fast", &["sh", "own.sh", "--fast"][..]),
            ("python3 'my model.py' \"a \\\"b\\\"\"", &["python3", "my model.py", "a \"b\""]),
            (r"./my\ model ''", &["./my model", ""]),
            ("cat 'open", &["cat", "open"]),
            ("  ", &[]),
        ] {
            assert_eq!(split(line), words, "{line}");
        }
    }
}
