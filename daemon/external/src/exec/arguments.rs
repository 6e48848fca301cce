//! Protection of programs' arguments, which may contain secrets.

use std::cell::Cell;
use std::fmt;

use hmac::{Hmac, KeyInit, Mac};
use serde::{Serialize, Serializer};
use sha2::Sha256;
use toml::{Table, Value};

use super::CommandLine;

/// Number of hexadecimal digits of a fingerprint. The fingerprints of two different commands of one host are equal with
/// probability 2⁻⁴⁸.
const FINGERPRINT_DIGITS: usize = 12;

/// Text with which the fact about a program begins (`the program ./blur`).
const PROGRAM_FACT_PREFIX: &str = "the program ";

/// Names of the facts about programs.
const FACT_NAMES: [&str; 3] = ["Sensor", "Model", "Actuator"];

/// Tables of a pipeline's configuration in which earlier builds could name a program.
const PROGRAM_TABLES: [&str; 2] = ["sensor", "actuator"];

/// Key for fingerprints of commands. Equal commands have equal fingerprints.
///
/// The key is secret and stays on its host. Without the key, no program can find a short secret among the arguments by
/// trying values. A plain hash would allow such a search.
#[derive(Clone)]
pub struct FingerprintKey([u8; 32]);

impl FingerprintKey {
    /// Creates a key of random bytes.
    pub const fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// Returns the fingerprint of the whole command: the first 48 bits of HMAC-SHA256 (RFC 2104).
    fn fingerprint(&self, command: &CommandLine) -> String {
        let mut mac = Hmac::<Sha256>::new_from_slice(&self.0).expect("HMAC takes keys of any length");
        // The length marks where each word ends.
        let mut add_word = |word: &str| {
            mac.update(&(word.len() as u64).to_be_bytes());
            mac.update(word.as_bytes());
        };
        match command {
            CommandLine::Shell(line) => add_word(line),
            CommandLine::Words(words) => words.iter().for_each(|word| add_word(word)),
        }
        let mac_bytes = mac.finalize().into_bytes();
        mac_bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>()[..FINGERPRINT_DIGITS]
            .to_owned()
    }
}

impl fmt::Debug for FingerprintKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("FingerprintKey(hidden)")
    }
}

impl CommandLine {
    /// Returns the number of arguments and the fingerprint as text; `None` if there are no arguments.
    pub(super) fn fingerprint(&self, key: &FingerprintKey) -> Option<String> {
        let count = self.argument_count();
        (count > 0).then(|| format!("{count}, fingerprint {}", key.fingerprint(self)))
    }
}

thread_local! {
    // Serde passes no context to nested values, and only the values know which of their fields hold commands.
    static SHOWS_ARGUMENTS: Cell<bool> = const { Cell::new(false) };
}

/// Calls `write`. During this call, each command is serialized with its arguments. The arguments may be secret, so only
/// files and processes of the same operating-system user may get the result.
///
/// At any other time a command is serialized as its program and the number of its arguments, whatever the name of the
/// field that holds the command.
pub fn with_arguments<T>(write: impl FnOnce() -> T) -> T {
    /// Restores the previous value of `SHOWS_ARGUMENTS`, also when `write` panics.
    struct ShowsArgumentsGuard(bool);

    impl Drop for ShowsArgumentsGuard {
        fn drop(&mut self) {
            SHOWS_ARGUMENTS.set(self.0);
        }
    }

    let _restore = ShowsArgumentsGuard(SHOWS_ARGUMENTS.replace(true));
    write()
}

/// Published form of a command.
#[derive(Serialize)]
struct PublicCommand<'a> {
    arguments: usize,
    program: &'a str,
}

impl<'a> From<&'a CommandLine> for PublicCommand<'a> {
    fn from(command: &'a CommandLine) -> Self {
        Self { arguments: command.argument_count(), program: command.program() }
    }
}

impl Serialize for CommandLine {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            command if !SHOWS_ARGUMENTS.get() => PublicCommand::from(command).serialize(serializer),
            Self::Shell(line) => line.serialize(serializer),
            Self::Words(words) => words.serialize(serializer),
        }
    }
}

/// Hides the arguments of commands in the configuration of a pipeline (TOML), which an earlier build may have stored.
/// Each command is replaced with its program and the number of its arguments. Text that is not TOML is replaced as a
/// whole if it contains the word `command`.
pub fn hide_arguments(configuration: &str) -> String {
    // Most configurations have no command and stay exactly as they were written.
    if !configuration.contains("command") {
        return configuration.to_owned();
    }
    let Ok(mut table) = configuration.parse::<Table>() else {
        return "# this configuration cannot be shown: it is not TOML, and may contain arguments of programs\n".to_owned();
    };
    for name in PROGRAM_TABLES {
        let command = table.get_mut(name).and_then(|inner| inner.get_mut("command"));
        if let Some(command) = command
            && let Ok(command_line) = command.clone().try_into::<CommandLine>()
        {
            match Value::try_from(PublicCommand::from(&command_line)) {
                Ok(public_command) => *command = public_command,
                Err(error) => return format!("# this configuration cannot be shown: {error}\n"),
            }
        }
    }
    toml::to_string(&table).unwrap_or_else(|error| format!("# this configuration cannot be shown: {error}\n"))
}

/// Removes the arguments from facts that name a program with its arguments, as earlier builds stored them.
pub fn hide_arguments_in_facts(facts: &mut [(String, String)]) {
    for (name, fact) in facts {
        if FACT_NAMES.contains(&name.as_str())
            && let Some(line) = fact.strip_prefix(PROGRAM_FACT_PREFIX)
        {
            let line = CommandLine::Shell(line.to_owned());
            *fact = program_fact(&line);
        }
    }
}

/// Returns the value of the fact about a program: `the program ./blur`.
pub(super) fn program_fact(command: &CommandLine) -> String {
    format!("{PROGRAM_FACT_PREFIX}{}", command.program())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(words: &[&str]) -> CommandLine {
        CommandLine::Words(words.iter().map(|word| (*word).to_owned()).collect())
    }

    #[test]
    fn fingerprints_tell_commands_and_keys_apart() {
        let key = FingerprintKey::new([1; 32]);
        let fingerprint = |command: &CommandLine| command.fingerprint(&key).expect("has arguments");
        let first = fingerprint(&words(&["./blur", "--token", "hunter2"]));
        assert_eq!(first, fingerprint(&words(&["./blur", "--token", "hunter2"])));
        assert!(first.starts_with("2, fingerprint ") && !first.contains("hunter"), "{first}");
        for other in [&["./blur", "--token", "hunter3"][..], &["./blur", "--tokenhunter2", ""]] {
            assert_ne!(first, fingerprint(&words(other)));
        }
        let with_other_key =
            words(&["./blur", "--token", "hunter2"]).fingerprint(&FingerprintKey::new([2; 32]));
        assert_ne!(Some(first), with_other_key);
        assert_eq!(words(&["./blur"]).fingerprint(&key), None);
        assert_eq!(format!("{key:?}"), "FingerprintKey(hidden)");
    }

    #[test]
    fn only_arguments_are_hidden_in_configurations() {
        let plain = "name = \"line\"\n\n[sensor]\nkind = \"synthetic\"\nsize_bytes = 100\n";
        assert_eq!(hide_arguments(plain), plain);
        let text = "name = 'line'\nsensor = { kind = 'exec', command = ['./light', '--token', 'hunter2'], timeout_ms = 5 }\n\
            actuator = { kind = 'exec', command = 'TOKEN=hunter3 ./act | tee log' }";
        let shown_text = hide_arguments(text);
        assert!(!shown_text.contains("hunter") && !shown_text.contains("--token"), "{shown_text}");
        let table: Table = shown_text.parse().expect("is TOML");
        assert_eq!(table["sensor"]["command"]["program"].as_str(), Some("./light"));
        assert_eq!(table["sensor"]["command"]["arguments"].as_integer(), Some(2));
        assert_eq!(table["sensor"]["timeout_ms"].as_integer(), Some(5));
        assert_eq!(table["actuator"]["command"]["program"].as_str(), Some("sh"));
        assert_eq!(hide_arguments(&shown_text), shown_text, "hiding the arguments again changes nothing");
        assert!(!hide_arguments("command = hunter2").contains("hunter"));
    }

    #[test]
    fn arguments_of_command_are_hidden_under_any_key() {
        /// Configuration whose keys for commands have other names than `command`.
        #[derive(Serialize)]
        #[serde(tag = "kind", rename_all = "kebab-case")]
        enum Kind {
            Service { launch: CommandLine, then: Vec<CommandLine> },
        }

        #[derive(Serialize)]
        struct Pipeline {
            sensor: Kind,
        }

        let shell = CommandLine::Shell("TOKEN=hunter3 ./act | tee log".to_owned());
        let launch = words(&["./light", "--token", "hunter2"]);
        let pipeline = Pipeline { sensor: Kind::Service { launch: launch.clone(), then: vec![shell] } };
        let write = || toml::to_string(&pipeline).expect("TOML");
        let shown_text = write();
        assert!(!shown_text.contains("hunter"), "{shown_text}");
        let table: Table = shown_text.parse().expect("TOML");
        let expected = |program: &str, arguments: i64| {
            Value::Table(Table::from_iter([
                ("program".to_owned(), Value::String(program.to_owned())),
                ("arguments".to_owned(), Value::Integer(arguments)),
            ]))
        };
        assert_eq!(table["sensor"]["launch"], expected("./light", 2));
        assert_eq!(table["sensor"]["then"][0], expected("sh", 1));

        let full_table: Table = with_arguments(write).parse().expect("TOML");
        assert_eq!(full_table["sensor"]["launch"].clone().try_into(), Ok(launch));
        assert_eq!(write(), shown_text, "arguments are shown only within `with_arguments`");
    }

    #[test]
    fn facts_of_earlier_builds_lose_their_arguments() {
        let fact = |name: &str, value: &str| (name.to_owned(), value.to_owned());
        let mut facts = [
            fact("Sensor", "the program ./light --token hunter2"),
            fact("Model", "the program while read x; do hunter3; done"),
            fact("Actuator", "log"),
            fact("Notes", "the program ./light 5"),
        ];
        let expected = [("Sensor", "the program ./light"), ("Model", "the program sh"), ("Actuator", "log")];
        // The second pass shows that a fact whose arguments have been removed stays as it is.
        for _ in 0..2 {
            hide_arguments_in_facts(&mut facts);
            assert_eq!(&facts[..3], expected.map(|(name, value)| fact(name, value)));
            assert_eq!(facts[3].1, "the program ./light 5");
        }
    }
}
