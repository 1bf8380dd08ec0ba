//! probe
use imrs_model::*; use imrs_model::worlds::*; use imrs_protocol::rules::*;
fn run(name:&str, s:std::sync::Arc<Scenario>){ let e=explore(&s, Limits{states:6_000_000,memory:6<<30}, None);
 println!("{name:40} {:?} states {} trans {} depth {} len {:?} max {}B {:.2}s {:.2}M/s complete {}", e.violation, e.states,e.transitions,e.depth,e.path.as_ref().map(|p|p.len()),e.longest_state,e.seconds,e.transitions as f64/e.seconds/1e6,e.complete);
 if std::env::var("PATH_").is_ok(){ if let Some(p)=e.path {println!("   {p:?}");}}}
fn main(){
 for n in 2..=4 { for (c,nm) in [(Confirmation::None,"none"),(Confirmation::FirstComplete,"first"),(Confirmation::EveryComplete,"every"),(Confirmation::PassOn,"pass")] {
  for loss in 0..=n as u8 { 
   let mut m=Meeting::new(n, Watch::Stranded); m.budget.loss=loss; m.rules.confirmation=c; m.rules.answer_late_arrivals=false;
   let s=m.scenario().unwrap(); let e=explore(&s, Limits::default(),None);
   print!("n={n} {nm} L={loss}: {:?} {} {:.2}s len {:?}; ", e.violation, e.states, e.seconds, e.path.as_ref().map(|p|p.len())); if e.violation.is_some(){break;} } println!(); } }
 let mut m=Meeting::new(2,Watch::FalseRelease); m.time_out=Some(6); m.delay=Some(1); m.resend=Some(2); m.losses=1; m.margin=None; m.attempts=Some(3); m.budget.loss=2; m.budget.dup=1;
 run("false n2", m.scenario().unwrap());
 m.members=3; m.attempts=Some(1); m.budget.loss=1; m.budget.dup=0; m.time_out=Some(7); run("false n3 1", m.scenario().unwrap());
}
