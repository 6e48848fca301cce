//! Tests that each kind of sensor, transform, model, actuator and network is named in its own file and where it is
//! registered, and in no other source file.

use std::fs;
use std::path::{Path, PathBuf};

use proc_macro2::TokenTree;
use syn::visit::Visit;
use syn::{GenericArgument, Item, PathArguments, Type};

use crate::layers::modules::{ReferencedPaths, Segments};

/// Enum of each extension point, and the file that declares it. CONTRIBUTING.md has the same list.
const REGISTRATIONS: [(&str, &str); 5] = [
    ("SensorConfig", "daemon/sensors/src/sensor/mod.rs"),
    ("TransformConfig", "daemon/sensors/src/transform/mod.rs"),
    ("ModelConfig", "daemon/inference/src/model/mod.rs"),
    ("ActuatorConfig", "daemon/actuators/src/lib.rs"),
    ("NetworkKind", "daemon/networks/src/transport/mod.rs"),
];

/// Files that name a kind outside its file: the file or folder, the kind's module, and the reason.
const EXCEPTIONS: [(&str, &str, &str); 2] = [
    ("daemon/inference/src/bank", "onnx", "a folder of models holds ONNX models with their cards"),
    ("daemon/inference/src/lib.rs", "onnx", "[onnxruntime] is a table of its own, and commands show cards"),
];

/// Kind of an extension point.
struct Kind {
    /// Enum of which it is a variant.
    registry: &'static str,
    variant: String,
    /// Parent of the kind's module.
    parent: String,
    /// Module of the kind.
    module: String,
    /// Configuration that the kind's own file declares.
    config: Option<String>,
    /// File or folder of the kind.
    files: PathBuf,
    /// File in which it is registered.
    registration: PathBuf,
}

impl Kind {
    /// Returns whether a path names the kind.
    fn is_named_by(&self, path: &Segments) -> bool {
        let contains_pair =
            |first: &str, second: &str| path.windows(2).any(|pair| pair[0] == first && pair[1] == second);
        contains_pair(self.registry, &self.variant)
            || contains_pair(&self.parent, &self.module)
            || self.config.as_ref().is_some_and(|config| path.contains(config))
    }
}

fn items(file: &Path) -> Vec<Item> {
    let text = fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    syn::parse_file(&text).unwrap_or_else(|error| panic!("{}: {error}", file.display())).items
}

/// Returns all kinds of an extension point.
fn kinds(registry: &'static str, registration: &str) -> Vec<Kind> {
    let registration = peernet_tests::root().join(registration);
    let folder = registration.parent().expect("in a folder");
    // A module directly below the root is reached by the name of the crate.
    let parent = match folder.file_name().and_then(|name| name.to_str()).expect("has a name") {
        "src" => {
            let name = folder.parent().and_then(Path::file_name).expect("in the folder of the crate");
            format!("peernet_{}", name.to_str().expect("is text"))
        }
        name => name.to_owned(),
    };
    let mut kinds = Vec::new();
    for item in items(&registration) {
        match item {
            Item::Enum(item) if item.ident == registry => {
                for variant in item.variants {
                    let field = variant.fields.iter().next().expect("a variant holds its configuration");
                    let path = configuration_path(&field.ty);
                    let [module, config] = &path[..] else { panic!("write module::Configuration: {path:?}") };
                    kinds.push((variant.ident.to_string(), module.clone(), Some(config.clone())));
                }
            }
            Item::Macro(item) if item.mac.path.is_ident("networks") => {
                let tokens: Vec<TokenTree> = item.mac.tokens.into_iter().collect();
                let is_text = |token: &TokenTree, text: &str| token.to_string() == text;
                for line in tokens.split(|token| is_text(token, ";")).filter(|line| !line.is_empty()) {
                    let after = |text| line.iter().skip_while(|token| !is_text(token, text)).nth(1);
                    let before = line.iter().take_while(|token| !is_text(token, "=")).last();
                    let [variant, module] =
                        [before, after("in")].map(|token| token.expect("is there").to_string());
                    kinds.push((variant, module, None));
                }
            }
            _ => {}
        }
    }
    let kind = |(variant, module, config): (String, String, Option<String>)| {
        let [file, module_folder] = [folder.join(format!("{module}.rs")), folder.join(&module)];
        let files = if file.is_file() { file } else { module_folder };
        // A configuration that several kinds of model or sensor share is declared elsewhere.
        let config = config.filter(|config| declares(&files, config));
        let (parent, registration) = (parent.clone(), registration.clone());
        Kind { registry, variant, parent, module, config, files, registration }
    };
    kinds.into_iter().map(kind).collect()
}

/// Returns the path of a kind's configuration: the type argument of `ModelTable<onnx::OnnxConfig>`.
fn configuration_path(table: &Type) -> Segments {
    let Type::Path(path) = table else { panic!("a configuration is named by a path") };
    let inner = path.path.segments.iter().find_map(|segment| match &segment.arguments {
        PathArguments::AngleBracketed(inner) => inner.args.first(),
        _ => None,
    });
    match inner {
        Some(GenericArgument::Type(inner)) => configuration_path(inner),
        _ => path.path.segments.iter().map(|segment| segment.ident.to_string()).collect(),
    }
}

/// Returns whether a file, or a file in a folder, declares a struct.
fn declares(files: &Path, name: &str) -> bool {
    let is_struct = |item: &Item| matches!(item, Item::Struct(item) if item.ident == name);
    sources(files).iter().any(|file| items(file).iter().any(is_struct))
}

/// Returns the source files of a folder and of those below it, or the file itself, without test files.
fn sources(path: &Path) -> Vec<PathBuf> {
    if path.is_file() {
        return vec![path.to_owned()];
    }
    let mut found = Vec::new();
    for entry in fs::read_dir(path).unwrap_or_else(|error| panic!("{}: {error}", path.display())) {
        let path = entry.expect("is readable").path();
        let name = path.file_stem().and_then(|name| name.to_str()).unwrap_or_default();
        if name == "tests" {
            continue;
        }
        if path.is_dir() || path.extension().is_some_and(|ending| ending == "rs") {
            found.extend(sources(&path));
        }
    }
    found
}

/// Returns the source files of all programs and libraries.
fn all_sources() -> Vec<PathBuf> {
    let root = peernet_tests::root();
    let crates = fs::read_dir(root.join("daemon")).expect("the crates are there");
    let crates = crates.map(|entry| entry.expect("is readable").path()).chain([root.join("web")]);
    crates
        .map(|folder| folder.join("src"))
        .filter(|folder| folder.is_dir())
        .flat_map(|src| sources(&src))
        .collect()
}

#[test]
fn kind_is_named_in_its_file_and_registration() {
    let kinds: Vec<Kind> = REGISTRATIONS.iter().flat_map(|(registry, file)| kinds(registry, file)).collect();
    for (registry, file) in REGISTRATIONS {
        assert!(kinds.iter().any(|kind| kind.registry == registry), "{file} registers no {registry}");
    }
    let root = peernet_tests::root();
    let (mut problems, mut used_exceptions) = (Vec::new(), Vec::new());
    for file in all_sources() {
        let mut references = ReferencedPaths::default();
        items(&file).iter().for_each(|item| references.visit_item(item));
        let is_elsewhere = |kind: &&Kind| !file.starts_with(&kind.files) && file != kind.registration;
        for kind in kinds.iter().filter(is_elsewhere) {
            let Some(path) = references.paths.iter().find(|path| kind.is_named_by(path)) else { continue };
            let exception = EXCEPTIONS
                .iter()
                .find(|(path, module, _)| *module == kind.module && file.starts_with(root.join(path)));
            match exception {
                Some(exception) => used_exceptions.push(exception),
                None => problems.push(format!("{}: {}", file.display(), path.join("::"))),
            }
        }
    }
    assert!(
        problems.is_empty(),
        "kinds are named outside their own files; call the trait of the extension point instead:\n{}",
        problems.join("\n")
    );
    for exception in &EXCEPTIONS {
        assert!(used_exceptions.contains(&exception), "this exception is needed no more: {exception:?}");
    }
}

/// Returns the variant's name as configurations write it: `zmq-tcp` for `ZmqTcp`.
fn kebab_case(variant: &str) -> String {
    let mut name = String::new();
    for letter in variant.chars() {
        if letter.is_ascii_uppercase() && !name.is_empty() {
            name.push('-');
        }
        name.push(letter.to_ascii_lowercase());
    }
    name
}

/// Returns the values of `kind` in the JSON and TOML of a source file, such as `"kind": "text"` or `kind = 'text'`,
/// without those in comments and in tests, which are at the end of the file.
fn kinds_in_text(source: &str) -> Vec<String> {
    let code = source.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    let value = |after: &str| {
        let is_quote = |letter: char| ['"', '\'', '\\'].contains(&letter);
        let after = after.trim_start_matches(is_quote).trim_start();
        let after = after.strip_prefix([':', '='])?.trim_start();
        let value = after.trim_start_matches(is_quote);
        let end = value.find(is_quote)?;
        // A value without quotes, such as a variable, is no kind.
        (value.len() < after.len()).then(|| value[..end].to_owned())
    };
    lines.flat_map(|line| line.split("kind").skip(1).filter_map(value).collect::<Vec<_>>()).collect()
}

#[test]
fn text_of_configurations_names_no_kind() {
    assert_eq!(kinds_in_text("json!({ \"kind\": \"text\" }); // kind"), ["text"]);
    assert_eq!(kinds_in_text("let a = \"kind = 'a'\\nkind = \\\"b\\\"\";\n// kind = 'c'"), ["a", "b"]);
    assert_eq!(kinds_in_text("kind == \"a\"\n#[cfg(test)]\nmod tests { \"kind = 'b'\" }"), [""; 0]);
    let kinds: Vec<Kind> = REGISTRATIONS.iter().flat_map(|(registry, file)| kinds(registry, file)).collect();
    let mut problems = Vec::new();
    for file in all_sources() {
        let names = kinds_in_text(&fs::read_to_string(&file).expect("is readable"));
        // A name that several extension points share may occur in the files of each.
        let is_own = |kind: &Kind| file.starts_with(&kind.files) || file == kind.registration;
        for name in names {
            let mut kinds_of_name = kinds.iter().filter(|kind| kebab_case(&kind.variant) == name).peekable();
            if kinds_of_name.peek().is_some() && !kinds_of_name.any(is_own) {
                problems.push(format!("{}: kind {name}", file.display()));
            }
        }
    }
    assert!(
        problems.is_empty(),
        "kinds are named outside their own files; give a kind's file a constructor:\n{}",
        problems.join("\n")
    );
}

#[test]
fn contributing_names_all_registration_files() {
    let text = fs::read_to_string(peernet_tests::root().join("CONTRIBUTING.md")).expect("is there");
    for (_, file) in REGISTRATIONS {
        assert!(text.contains(&format!("]({file})")), "CONTRIBUTING.md does not name {file}");
    }
}
