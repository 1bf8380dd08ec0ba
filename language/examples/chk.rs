use imrs_language::*;
fn main() {
    let quiet = std::env::args().any(|a| a == "-q");
    let paper = std::env::args().any(|a| a == "--paper");
    for f in std::env::args().skip(1).filter(|a| !a.starts_with('-')) {
        let bytes = std::fs::read(&f).unwrap();
        let source = Source::new(&bytes).unwrap();
        let c = compile_with(&source, Options { paper });
        if quiet {
            let codes: Vec<String> = c
                .diagnostics
                .iter()
                .map(|d| {
                    let (l, k) = source.position(d.primary.span.start);
                    format!("{} {l}:{k}", d.code)
                })
                .collect();
            println!("{f}: {codes:?}");
        } else {
            println!("{}", render::text(&c.diagnostics, &f, Some(&source), render::Style::Plain));
        }
    }
}
