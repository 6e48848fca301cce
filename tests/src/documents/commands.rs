//! Extraction of command lines from a document.

use super::Document;

/// The programs of PEERNet. Alone, or with one more word, they are names of commands in prose.
const OUR_PROGRAMS: [&str; 4] = ["peernet", "peernetd", "PEERNet", "peernet_cli"];

impl Document {
    /// Returns the command lines in blocks, fenced or indented by four spaces, and those in prose that run one of our
    /// programs, a script of the checkout or a target of the Makefile.
    ///
    /// Comments, prompts and `sudo` are removed, continued lines joined, and words separated by single spaces.
    pub fn commands(&self) -> Vec<String> {
        let fenced = ["sh", "console"].into_iter().flat_map(|language| self.fenced_blocks(language));
        let fenced = fenced.flat_map(|(_, block)| command_lines(&block));
        let indented: String =
            self.prose().filter(|(_, line)| line.starts_with("    ")).map(with_line_end).collect();
        let indented = command_lines(&indented).into_iter().filter(|line| !is_setting(line));
        let inline = self.inline_code().into_iter().filter(|span| is_complete_command(span));
        fenced.chain(indented).chain(inline).collect()
    }

    /// Returns the texts between back quotes, paragraph by paragraph, so that an unclosed quote affects its paragraph
    /// only. Headings are left out, because they contain only names of commands.
    fn inline_code(&self) -> Vec<String> {
        let prose: String =
            self.prose().filter(|(_, line)| !line.starts_with('#')).map(with_line_end).collect();
        let paragraphs = prose.split("\n\n");
        paragraphs.flat_map(|text| text.split('`').skip(1).step_by(2)).map(single_spaced).collect()
    }
}

fn with_line_end((_, line): (usize, &str)) -> String {
    format!("{line}\n")
}

/// Returns the command lines of a block. If some lines begin with a prompt, only these lines are commands.
fn command_lines(block: &str) -> Vec<String> {
    let joined = block.replace("\\\n", " ");
    let has_prompts = joined.lines().any(|line| line.starts_with("$ "));
    let lines =
        joined.lines().filter_map(|line| if has_prompts { line.strip_prefix("$ ") } else { Some(line) });
    let lines = lines.filter(|line| !line.trim_start().starts_with('#'));
    let lines = lines.map(|line| line.split(" # ").next().unwrap_or_default());
    let lines = lines.map(|line| single_spaced(line).trim_start_matches("sudo ").to_owned());
    lines.filter(|line| !line.is_empty()).collect()
}

fn single_spaced(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Returns whether a line belongs to a configuration or environment file, which blocks without a language show as
/// well.
fn is_setting(line: &str) -> bool {
    let (first, rest) = line.split_once(' ').unwrap_or((line, ""));
    first.starts_with('[') || rest.starts_with("= ") || (first.contains('=') && rest.is_empty())
}

/// Returns whether a text in prose is a complete command: `peernet run` is the name of a command, and
/// `peernet --client …` stands for a group of commands.
fn is_complete_command(span: &str) -> bool {
    let words: Vec<&str> = span.split(' ').collect();
    let program = words[0];
    let min_words = match program {
        "make" => 2,
        _ if OUR_PROGRAMS.contains(&program.rsplit('/').next().unwrap_or_default()) => 3,
        _ if program.contains('/') && (program.ends_with(".sh") || program.ends_with(".py")) => 2,
        _ => return false,
    };
    words.len() >= min_words && !words.contains(&"…")
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    fn commands(text: &str) -> Vec<String> {
        Document { path: PathBuf::new(), text: text.to_owned() }.commands()
    }

    #[test]
    fn block_with_prompts_has_commands_and_output() {
        let text = "```console\n$ peernet run a.toml    # in another\npeernet is done\n$ ls\n```\n";
        assert_eq!(commands(text), ["peernet run a.toml", "ls"]);
        assert_eq!(commands("```text\npeernet run a\n```\n"), [""; 0]);
    }

    #[test]
    fn block_without_prompts_has_commands_only() {
        let text =
            "```sh\nsudo apt-get install it\n\n# of the package\nsudo bin/peernetd check \\\n    FILE\n```\n";
        assert_eq!(commands(text), ["apt-get install it", "bin/peernetd check FILE"]);
    }

    #[test]
    fn configuration_lines_are_not_commands() {
        let text = "Like this:\n\n    curl -N there\n    [agent]\n    name = \"it\"    # its name\n    A=/b:/c\n    A=b run\n";
        assert_eq!(commands(text), ["curl -N there", "A=b run"]);
    }

    #[test]
    fn commands_in_prose_are_found() {
        let text = "`peernet run` and `peernet --client …` are names. With `peernet plot\n--kind stacked` bars are drawn.";
        assert_eq!(commands(text), ["peernet plot --kind stacked"]);
        assert_eq!(commands("### `peernet models list`\n"), [""; 0]);
        assert_eq!(commands("A ` alone.\n\nThen `peernet models list`."), ["peernet models list"]);
        let text =
            "`make demo` is `deploy/demo.sh PROGRAM`; `make`, `deploy/demo.sh` and `systemctl edit it` tell.";
        assert_eq!(commands(text), ["make demo", "deploy/demo.sh PROGRAM"]);
    }
}
