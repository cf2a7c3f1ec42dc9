// Typesets the formulas that pymdownx.arithmatex has marked: \(...\) in a line, \[...\] displayed.
for (const element of document.querySelectorAll(".arithmatex")) {
  const text = element.textContent;
  katex.render(text.slice(2, -2), element, { displayMode: text.startsWith("\\[") });
}
