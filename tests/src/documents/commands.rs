//! The command lines that a document shows.

use super::Document;

/// Programs whose command lines count. Of others, such as a system's package manager, the documents tell in passing.
const PROGRAMS: [&str; 7] = ["peernet", "peernetd", "PEERNet", "peernet_cli", "python3", "cc", "curl"];

/// Those of ours: their names alone, and with one word more, are how prose speaks of them.
const OURS: [&str; 4] = ["peernet", "peernetd", "PEERNet", "peernet_cli"];

impl Document {
    /// The command lines in blocks, fenced or set off by four spaces, and those of our programs in the prose; comments,
    /// prompts and `sudo` are taken away, lines that go on joined, spaces between words are single.
    pub fn commands(&self) -> Vec<String> {
        let fenced = ["sh", "console"].into_iter().flat_map(|language| self.fenced(language));
        let fenced = fenced.flat_map(|(_, block)| typed(&block));
        let set_off: String =
            self.prose().filter(|(_, line)| line.starts_with("    ")).map(end_line).collect();
        let blocks = fenced.chain(typed(&set_off)).filter(|line| runs(line, &PROGRAMS));
        let inline = self.spans().into_iter().filter(|span| runs(span, &OURS) && is_whole(span));
        blocks.chain(inline).collect()
    }

    /// What stands between back quotes, paragraph by paragraph: a quote that is not closed spoils no other paragraph.
    /// Headings have names of commands only.
    fn spans(&self) -> Vec<String> {
        let prose: String = self.prose().filter(|(_, line)| !line.starts_with('#')).map(end_line).collect();
        let paragraphs = prose.split("\n\n");
        paragraphs.flat_map(|text| text.split('`').skip(1).step_by(2)).map(single_spaced).collect()
    }
}

fn end_line((_, line): (usize, &str)) -> String {
    format!("{line}\n")
}

/// What is typed of a block: where some lines begin with a prompt, these alone.
fn typed(block: &str) -> Vec<String> {
    let joined = block.replace("\\\n", " ");
    let prompted = joined.lines().any(|line| line.starts_with("$ "));
    let lines = joined.lines().filter_map(|line| if prompted { line.strip_prefix("$ ") } else { Some(line) });
    let lines = lines.map(|line| line.split(" # ").next().unwrap_or_default());
    lines.map(|line| single_spaced(line).trim_start_matches("sudo ").to_owned()).collect()
}

fn single_spaced(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Whether a line runs one of these programs, wherever that lies.
fn runs(line: &str, programs: &[&str]) -> bool {
    let program = line.split(' ').next().and_then(|path| path.rsplit('/').next());
    program.is_some_and(|program| programs.contains(&program))
}

/// Whether it can be typed: `peernet run` is the name of a command, and `peernet --client …` tells of a kind.
fn is_whole(span: &str) -> bool {
    let words: Vec<&str> = span.split(' ').collect();
    words.len() > 2 && !words.contains(&"…")
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    fn commands(text: &str) -> Vec<String> {
        Document { path: PathBuf::new(), text: text.to_owned() }.commands()
    }

    #[test]
    fn a_block_with_prompts_shows_commands_and_what_they_say() {
        let text = "```console\n$ peernet run a.toml    # in another\npeernet is done\n$ ls\n```\n";
        assert_eq!(commands(text), ["peernet run a.toml"]);
        assert_eq!(commands("```console\nUsers  edges\n```\n```text\npeernet run a\n```\n"), [""; 0]);
    }

    #[test]
    fn a_block_without_shows_commands_alone() {
        let text = "```sh\nsudo apt-get install it\nsudo bin/peernetd check \\\n    FILE\n```\n";
        assert_eq!(commands(text), ["bin/peernetd check FILE"]);
        assert_eq!(commands("Like this:\n\n    curl -N there\n    [agent]\n"), ["curl -N there"]);
    }

    #[test]
    fn prose_names_commands_and_shows_some() {
        let text = "`peernet run` and `peernet --client …` are names. With `peernet plot\n--kind stacked` bars are drawn.";
        assert_eq!(commands(text), ["peernet plot --kind stacked"]);
        assert_eq!(commands("### `peernet models list`\n"), [""; 0]);
        assert_eq!(commands("A ` alone.\n\nThen `peernet models list`."), ["peernet models list"]);
    }
}
