//! What is told of an object, so that a run can be done again.

use super::Module;

#[test]
fn the_file_and_the_libraries_of_an_object_are_told() {
    let source = "import numpy\nclass Own:\n    def infer(self, x): return x\n";
    let module = Module::new(source, "own::Own");
    let facts = module.model().about().facts("Model");
    let names: Vec<&str> = facts.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["Model", "Model files", "Model libraries"]);
    assert!(facts[0].1.starts_with("the Python class own::Own, Python 3."), "{facts:?}");
    let (path, hash) = facts[1].1.split_once(" SHA-256 ").expect("has one");
    assert_eq!(
        path,
        module.folder.path().canonicalize().expect("is there").join("own.py").display().to_string()
    );
    let bytes = std::fs::read(path).expect("is there");
    assert_eq!(hash, peernet_external::sha256(bytes.as_slice()).expect("is read"));
    assert!(facts[2].1.split(", ").any(|library| library.starts_with("numpy ")), "{facts:?}");
}

#[test]
fn an_object_that_misleads_about_itself_is_had_all_the_same() {
    for own in [
        "__file__ = None",
        "del __file__",
        "__file__ = 'a' * (2 << 20)",
        "__file__ = '\\udcff\\x1b[31m'",
        "sys.modules['numpy'] = types.SimpleNamespace(__version__='\\ud800\\x1b')",
        "class Odd:\n    def __getattr__(self, name): raise OSError(name)\nsys.modules['torch'] = Odd()",
        "sys.modules['torch'] = None",
    ] {
        let source = format!("import sys, types\n{own}\nclass Own:\n    def infer(self, x): return x\n");
        let module = Module::new(&source, "own::Own");
        let facts = module.model().about().facts("Model");
        assert_eq!(facts[0].0, "Model");
        assert!(
            facts.iter().all(|(_, told)| !told.contains('\x1b') && told.len() < 9000),
            "{own}: {facts:?}"
        );
    }
}
