// Browsers refuse workers to pages that are opened as files: there an invisible frame does the work of the search.
if (location.protocol === "file:") {
  window.Worker = class {
    constructor(url) {
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      this.frame.srcdoc =
        '<script>postMessage = data => parent.postMessage(data, "*")</' + "script>" +
        `<script src="${url}"></` + "script>";
      addEventListener("message", ({ source, data }) => {
        if (source === this.frame.contentWindow) this.onmessage?.({ data });
      });
      this.ready = new Promise(done => this.frame.addEventListener("load", done));
      document.body.append(this.frame);
    }

    postMessage(data) {
      // The frame's own postMessage leads back here.
      this.ready.then(() => window.postMessage.call(this.frame.contentWindow, data, "*"));
    }

    terminate() {
      this.frame.remove();
    }
  };
}
