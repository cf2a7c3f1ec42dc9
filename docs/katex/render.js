// Typesets the formulas that pymdownx.arithmatex has marked: \(...\) in a line, \[...\] displayed.
for (const element of document.querySelectorAll(".arithmatex")) {
  const text = element.textContent;
  const displayMode = text.startsWith("\\[");
  const next = displayMode ? null : element.nextSibling;
  // A mark behind a formula must not begin the next line.
  const mark = next?.nodeType === Node.TEXT_NODE ? next.data.match(/^[.,;:)]*/)[0] : "";
  if (mark) next.data = next.data.slice(mark.length);
  katex.render(`${text.slice(2, -2)}\\text{${mark}}`, element, { displayMode });
}
