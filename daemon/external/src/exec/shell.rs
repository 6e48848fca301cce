//! Analysis of a shell command line, without running it.

/// Returns the program of a line that consists of a single program with arguments; `None` for any other line. Other
/// lines contain an operator of the shell, or their first word may be an assignment or an expansion.
pub(super) fn single_program(line: &str) -> Option<&str> {
    let program = line.split_ascii_whitespace().next()?;
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"_-+./".contains(&byte);
    let operators = [';', '&', '|', '\n', '(', ')', '{', '}', '`', '\0'];
    (program.bytes().all(is_plain) && !line.contains(operators)).then_some(program)
}

/// Splits a line into words and removes quotes; `$NAME` and `*` are not expanded.
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
            (None | Some('"'), '\\') => match (quote, chars.next()) {
                (_, Some('\n')) => {}
                // Between double quotes a backslash is literal before all other characters.
                (Some(_), Some(next)) if !r#"$`"\"#.contains(next) => {
                    word.get_or_insert_default().extend(['\\', next]);
                }
                (_, next) => word.get_or_insert_default().extend(next),
            },
            (_, char) => word.get_or_insert_default().push(char),
        }
    }
    words.extend(word);
    words
}

/// Programs that run the first file among their arguments. Each entry has the name of the program without a version, and
/// the letters of the options with which the program runs code from its command line instead of a file.
const INTERPRETERS: [(&str, &str); 20] = [
    ("sh", "c"),
    ("bash", "c"),
    ("dash", "c"),
    ("ash", "c"),
    ("ksh", "c"),
    ("zsh", "c"),
    ("fish", "c"),
    ("env", "S"),
    ("python", "cm"),
    ("pypy", "cm"),
    ("perl", "eE"),
    ("ruby", "e"),
    ("node", "epr"),
    ("deno", "e"),
    ("bun", "epr"),
    ("php", "rBRE"),
    ("lua", "el"),
    ("luajit", "el"),
    ("julia", "eE"),
    ("Rscript", "e"),
];

/// Long options of these interpreters that are followed by code on the command line.
const INLINE_CODE_OPTIONS: [&str; 4] = ["--eval", "--print", "--command", "--split-string"];

/// Returns the script that an interpreter runs.
///
/// Returns `None` for other programs, and where the code is on the command line: the files after it are arguments and
/// may be secret.
pub(super) fn script(words: &[String], is_file: impl Fn(&str) -> bool) -> Option<&String> {
    let (program, arguments) = words.split_first()?;
    let name = program.rsplit('/').next().unwrap_or(program);
    let name = name.trim_end_matches(|char: char| char.is_ascii_digit() || char == '.');
    let (_, code_letters) = INTERPRETERS.iter().find(|(interpreter, _)| *interpreter == name)?;
    let announces_code = |argument: &String| {
        let letters = argument.strip_prefix('-').filter(|rest| !rest.starts_with('-'));
        letters.is_some_and(|letters| letters.contains(|letter| code_letters.contains(letter)))
            || INLINE_CODE_OPTIONS.iter().any(|option| argument.starts_with(option))
    };
    let arguments_before_code = arguments.iter().take_while(|argument| !announces_code(argument));
    arguments_before_code.into_iter().find(|argument| is_file(argument))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_is_split_into_words_like_by_shell() {
        for (line, words) in [
            ("sh own.sh  --fast", &["sh", "own.sh", "--fast"][..]),
            ("python3 'my model.py' \"a \\\"b\\\"\"", &["python3", "my model.py", "a \"b\""]),
            (r"./my\ model ''", &["./my model", ""]),
            ("cat 'open", &["cat", "open"]),
            (r#"echo "a\nb" "\$x""#, &["echo", r"a\nb", "$x"]),
            ("echo a\\\nb", &["echo", "ab"]),
            ("  ", &[]),
        ] {
            assert_eq!(split(line), words, "{line}");
        }
    }

    #[test]
    fn first_file_is_script_unless_code_given() {
        for (line, expected) in [
            ("python3.11 -u own.py data", Some("own.py")),
            ("bash -e own.sh", Some("own.sh")),
            ("/usr/bin/env python3 own.py", Some("own.py")),
            ("bash -lc 'cat own.sh' own.sh", None),
            ("python -m module own.py", None),
            ("perl -ne print own.txt", None),
            ("node --eval 1 own.js", None),
            ("cat own.txt", None),
        ] {
            let words = split(line);
            let script = script(&words, |word| word.starts_with("own."));
            assert_eq!(script.map(String::as_str), expected, "{line}");
        }
    }
}
