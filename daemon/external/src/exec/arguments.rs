//! A program's arguments may hold secrets: what is told of them.

use std::fmt;

use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;
use toml::{Table, Value};

use super::CommandLine;

/// Hexadecimal digits of a fingerprint: two commands of one host share one by chance once in 2⁴⁸.
const DIGITS: usize = 12;

/// What the fact about a program begins with.
const PROGRAM: &str = "the program ";

/// The facts that name a program.
const FACTS: [&str; 3] = ["Sensor", "Model", "Actuator"];

/// The tables of a pipeline that may name a program.
const TABLES: [&str; 2] = ["sensor", "actuator"];

/// Makes fingerprints of commands: equal commands have equal ones.
///
/// The key is secret and stays on its host. Without it a short secret among the arguments cannot be found by trying, as
/// it could with a plain hash.
#[derive(Clone)]
pub struct FingerprintKey([u8; 32]);

impl FingerprintKey {
    /// A key of these random bytes.
    pub const fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// A fingerprint of the whole command (HMAC-SHA256, RFC 2104, its first 48 bits).
    fn of(&self, command: &CommandLine) -> String {
        let mut mac = Hmac::<Sha256>::new_from_slice(&self.0).expect("HMAC takes keys of any length");
        // The length tells where each word ends.
        let mut word = |word: &str| {
            mac.update(&(word.len() as u64).to_be_bytes());
            mac.update(word.as_bytes());
        };
        match command {
            CommandLine::Shell(line) => word(line),
            CommandLine::Words(words) => words.iter().for_each(|each| word(each)),
        }
        let code = mac.finalize().into_bytes();
        code.iter().map(|byte| format!("{byte:02x}")).collect::<String>()[..DIGITS].to_owned()
    }
}

impl fmt::Debug for FingerprintKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("FingerprintKey(hidden)")
    }
}

impl CommandLine {
    /// The number of its arguments and its fingerprint, in words; `None` without arguments.
    pub(super) fn fingerprint(&self, key: &FingerprintKey) -> Option<String> {
        let count = self.arguments();
        (count > 0).then(|| format!("{count}, fingerprint {}", key.of(self)))
    }
}

/// Leaves the program and the number of its arguments of each command in a pipeline's table (TOML).
pub fn hide_arguments(configuration: &str) -> String {
    // Most have none, and stay as they were written.
    if !configuration.contains("command") {
        return configuration.to_owned();
    }
    let Ok(mut table) = configuration.parse::<Table>() else {
        return "# cannot be shown: it is no TOML, and may hold arguments of programs\n".to_owned();
    };
    for name in TABLES {
        let command = table.get_mut(name).and_then(|inner| inner.get_mut("command"));
        if let Some(command) = command
            && let Ok(line) = command.clone().try_into::<CommandLine>()
        {
            let count = i64::try_from(line.arguments()).unwrap_or(i64::MAX);
            *command = Value::Table(Table::from_iter([
                ("program".to_owned(), Value::String(line.program().to_owned())),
                ("arguments".to_owned(), Value::Integer(count)),
            ]));
        }
    }
    toml::to_string(&table).unwrap_or_else(|error| format!("# cannot be written down: {error}\n"))
}

/// Leaves the program alone of facts that name one with its arguments, as earlier builds stored them.
pub fn hide_arguments_in_facts(facts: &mut [(String, String)]) {
    for (name, fact) in facts {
        if FACTS.contains(&name.as_str())
            && let Some(line) = fact.strip_prefix(PROGRAM)
        {
            let line = CommandLine::Shell(line.to_owned());
            *fact = fact_of(&line);
        }
    }
}

/// `the program ./blur`.
pub(super) fn fact_of(command: &CommandLine) -> String {
    format!("{PROGRAM}{}", command.program())
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
        let of = |command: &CommandLine| command.fingerprint(&key).expect("has arguments");
        let one = of(&words(&["./blur", "--token", "hunter2"]));
        assert_eq!(one, of(&words(&["./blur", "--token", "hunter2"])));
        assert!(one.starts_with("2, fingerprint ") && !one.contains("hunter"), "{one}");
        for other in [&["./blur", "--token", "hunter3"][..], &["./blur", "--tokenhunter2", ""]] {
            assert_ne!(one, of(&words(other)));
        }
        let elsewhere = words(&["./blur", "--token", "hunter2"]).fingerprint(&FingerprintKey::new([2; 32]));
        assert_ne!(Some(one), elsewhere);
        assert_eq!(words(&["./blur"]).fingerprint(&key), None);
        assert_eq!(format!("{key:?}"), "FingerprintKey(hidden)");
    }

    #[test]
    fn configurations_lose_arguments_and_nothing_else() {
        let plain = "name = \"line\"\n\n[sensor]\nkind = \"synthetic\"\nsize_bytes = 100\n";
        assert_eq!(hide_arguments(plain), plain);
        let text = "name = 'line'\nsensor = { kind = 'exec', command = ['./light', '--token', 'hunter2'], timeout_ms = 5 }\n\
            actuator = { kind = 'exec', command = 'TOKEN=hunter3 ./act | tee log' }";
        let hidden = hide_arguments(text);
        assert!(!hidden.contains("hunter") && !hidden.contains("--token"), "{hidden}");
        let table: Table = hidden.parse().expect("is TOML");
        assert_eq!(table["sensor"]["command"]["program"].as_str(), Some("./light"));
        assert_eq!(table["sensor"]["command"]["arguments"].as_integer(), Some(2));
        assert_eq!(table["sensor"]["timeout_ms"].as_integer(), Some(5));
        assert_eq!(table["actuator"]["command"]["program"].as_str(), Some("sh"));
        assert_eq!(hide_arguments(&hidden), hidden, "once is enough");
        assert!(!hide_arguments("command = hunter2").contains("hunter"));
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
        let told = [("Sensor", "the program ./light"), ("Model", "the program sh"), ("Actuator", "log")];
        for _ in 0..2 {
            hide_arguments_in_facts(&mut facts);
            assert_eq!(&facts[..3], told.map(|(name, value)| fact(name, value)));
            assert_eq!(facts[3].1, "the program ./light 5");
        }
    }
}
