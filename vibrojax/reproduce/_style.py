"""The page's style sheet."""

STYLE = """\
:root { --ink: #222; --faint: #666; --line: #ddd; --agrees: #1b7f4b; --trend: #2f6f9f; --uncompared: #777;
  --differs: #b3261e; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: #fff; font: 16px/1.5 system-ui, "Segoe UI", Helvetica, Arial,
  sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 1.5rem 1.25rem 4rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .5rem; }
h2 { font-size: 1.3rem; margin: 2.5rem 0 .5rem; padding-top: .6rem; border-top: 2px solid var(--ink); }
p { max-width: 46rem; }
nav { display: flex; flex-wrap: wrap; gap: .3rem 1rem; font-size: .95rem; }
a { color: #0b5394; }
.score { display: grid; grid-template-columns: repeat(auto-fit, minmax(9rem, 1fr)); gap: .6rem; list-style: none;
  margin: 1.2rem 0; padding: 0; }
.score li { border: 1px solid var(--line); border-left: 5px solid; border-radius: 4px; padding: .5rem .8rem; }
.score b { display: block; font-size: 1.9rem; line-height: 1.1; }
.score .agrees { border-left-color: var(--agrees); }
.score .trend { border-left-color: var(--trend); }
.score .uncompared { border-left-color: var(--uncompared); }
.score .differs { border-left-color: var(--differs); }
.score .agrees, tr.agrees .verdict { color: var(--agrees); }
.score .trend, tr.trend .verdict { color: var(--trend); }
.score .uncompared, tr.uncompared .verdict { color: var(--uncompared); }
.score .differs, tr.differs .verdict { color: var(--differs); }
.findings { max-width: 54rem; padding-left: 2.2rem; }
.findings li { margin: .5rem 0; }
.findings small a { white-space: nowrap; }
.findings small { font-family: ui-monospace, Consolas, monospace; }
table { width: 100%; border-collapse: collapse; margin: 1rem 0; font-size: .92rem; }
th { text-align: left; font-weight: 600; border-bottom: 2px solid var(--line); padding: .3rem .6rem; }
td { vertical-align: top; border-bottom: 1px solid var(--line); padding: .45rem .6rem; overflow-wrap: anywhere; }
td.id { font-family: ui-monospace, Consolas, monospace; font-size: .85em; min-width: 7.5rem; }
td[data-name] { width: 21%; }
td.verdict { font-weight: 600; min-width: 7rem; }
td p { margin: .25rem 0 0; }
.note { color: var(--ink); font-size: .92em; }
.tolerance { color: var(--faint); font-size: .82em; }
.pictures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 30rem), 1fr)); gap: 1rem; }
figure { margin: 0; border: 1px solid var(--line); border-radius: 4px; padding: .6rem; break-inside: avoid; }
figure img { width: 100%; height: auto; display: block; }
figcaption { font-size: .88rem; color: var(--faint); margin-top: .4rem; }
dl { display: grid; grid-template-columns: 3rem 1fr; gap: .3rem .6rem; font-size: .92rem; }
dt { font-weight: 600; }
dd { margin: 0; }
footer { margin-top: 3rem; color: var(--faint); font-size: .85rem; }
@media (max-width: 700px) {
  main { padding: 1rem .8rem 3rem; }
  thead { display: none; }
  table, tbody, tr, td { display: block; width: 100% !important; }
  tr { border-bottom: 2px solid var(--line); padding: .6rem 0; }
  td { border: 0; padding: .1rem 0; }
  td.id { font-weight: 600; }
  td[data-name]::before { content: attr(data-name) ": "; color: var(--faint); }
}
@media print {
  @page { size: A4; margin: 14mm 12mm; }
  html { font-size: 8.5pt; }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  body { font-size: 8.5pt; line-height: 1.35; }
  main { max-width: none; padding: 0; }
  nav { display: none; }
  p { max-width: none; break-inside: avoid; }
  a { color: inherit; text-decoration: none; }
  table { table-layout: fixed; }
  th:first-child { width: 12%; }
  th:nth-child(3), th:nth-child(4) { width: 20%; }
  th:last-child { width: 11%; }
  td { padding: .25rem .5rem; }
  td.id, td.verdict, td[data-name] { min-width: 0; width: auto; }
  tr, li, dt, dd { break-inside: avoid; }
  h2 { break-after: avoid; margin-top: 1.5rem; }
  section > p { break-after: avoid; }
  .pictures { grid-template-columns: 1fr 1fr; gap: .6rem; }
}
"""
