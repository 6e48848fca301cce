//! Tests of parsing and writing XML-RPC.

use proptest::prelude::*;

use super::{Call, ParseError, Response, Value, parse_call, parse_response, write_call, write_response};

/// Returns texts without the characters that XML cannot contain.
fn texts() -> impl Strategy<Value = String> {
    "[\t\n\r -~äß€]{0,12}"
}

fn values() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![
        any::<i32>().prop_map(|number| Value::Int(number.into())),
        any::<bool>().prop_map(Value::Bool),
        (-1e12..1e12).prop_map(Value::Double),
        texts().prop_map(Value::Text),
    ];
    leaf.prop_recursive(4, 32, 5, |inner| {
        prop_oneof![
            proptest::collection::vec(inner.clone(), 0..5).prop_map(Value::Array),
            proptest::collection::vec((texts(), inner), 0..4).prop_map(Value::Struct),
        ]
    })
}

proptest! {
    #[test]
    fn call_decodes_to_encoded_value(method in "[a-zA-Z.]{1,12}", params in proptest::collection::vec(values(), 0..4)) {
        let call = Call { method, params };
        prop_assert_eq!(parse_call(write_call(&call).as_bytes()).unwrap(), call);
    }

    #[test]
    fn response_decodes_to_encoded_value(value in values(), code in -9_i64..9, text in texts()) {
        for response in [Response::Success(value), Response::Fault { code, text }] {
            prop_assert_eq!(parse_response(write_response(&response).as_bytes()).unwrap(), response);
        }
    }

    #[test]
    fn damaged_call_is_read_without_panic(
        params in proptest::collection::vec(values(), 0..4),
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut xml = write_call(&Call { method: "requestTopic".into(), params }).into_bytes();
        for (index, byte) in changes {
            let index = index.index(xml.len());
            xml[index] = byte;
        }
        let _ = parse_call(&xml);
        let _ = parse_response(&xml);
    }
}

#[test]
fn python_response_is_read() {
    // A response as Python's xmlrpc writes it.
    let xml = "<?xml version='1.0'?>\n<methodResponse>\n<params>\n<param>\n<value><array><data>\n\
               <value><int>1</int></value>\n<value><string>a &lt; b</string></value>\n\
               <value><boolean>1</boolean></value>\n</data></array></value>\n</param>\n</params>\n</methodResponse>\n";
    let expected = Value::from([Value::Int(1), "a < b".into(), Value::Bool(true)]);
    assert_eq!(parse_response(xml.as_bytes()).unwrap(), Response::Success(expected));
}

#[test]
fn value_without_type_is_text() {
    let xml = "<methodCall><methodName>m</methodName><params><param><value> a&#33; </value></param>\
               <param><value><string/></value></param><param><value/></param></params></methodCall>";
    let call = parse_call(xml.as_bytes()).unwrap();
    assert_eq!(call.params, [" a! ".into(), "".into(), "".into()]);
}

#[test]
fn call_without_params_is_read() {
    for params in ["", "<params/>", "<params></params>"] {
        let xml = format!("<methodCall><methodName>getPid</methodName>{params}</methodCall>");
        assert_eq!(parse_call(xml.as_bytes()).unwrap(), Call { method: "getPid".into(), params: vec![] });
    }
}

#[test]
fn document_types_and_entities_are_refused() {
    let xml = "<!DOCTYPE x [<!ENTITY a \"b\">]><methodCall><methodName>&a;</methodName></methodCall>";
    assert_eq!(parse_call(xml.as_bytes()).unwrap_err(), ParseError::DocumentType);
    let xml = "<methodCall><methodName>&a;</methodName></methodCall>";
    assert_eq!(parse_call(xml.as_bytes()).unwrap_err(), ParseError::UnknownEntity { name: "a".into() });
}

#[test]
fn depth_and_number_of_values_are_bounded() {
    let call = |value: &str| {
        format!("<methodCall><methodName>m</methodName><params><param>{value}</param></params></methodCall>")
    };
    let deeply_nested_call = call(&"<value><array><data>".repeat(100_000));
    assert_eq!(parse_call(deeply_nested_call.as_bytes()).unwrap_err(), ParseError::TooDeep);
    let array_with_many_values =
        format!("<value><array><data>{}</data></array></value>", "<value/>".repeat(100_001));
    assert_eq!(parse_call(call(&array_with_many_values).as_bytes()).unwrap_err(), ParseError::TooManyValues);
}
